"""The stage `questions`."""

from pipeline.config.options import WorkOptions
from pipeline.config.stage import Stage

STAGES = {"questions": Stage("pipeline.questions.stage", WorkOptions)}
