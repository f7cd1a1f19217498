"""The stage `analyse`."""

from pipeline.config import Stage, WorkOptions

STAGES = {"analyse": Stage("pipeline.inspection.analyse", WorkOptions, is_default=True)}
