"""The stage `questions`."""

from pipeline.config.options import WorkersOption
from pipeline.config.stage import Stage

STAGES = {"questions": Stage("pipeline.questions.stage", WorkersOption)}
