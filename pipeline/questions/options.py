"""The stage `questions`."""

from pipeline.config import Stage, WorkOptions

STAGES = {"questions": Stage("pipeline.questions.stage", WorkOptions)}
