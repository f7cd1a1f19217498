"""The stage `analyse`."""

from pipeline.config.options import WorkOptions
from pipeline.config.stage import Stage

STAGES = {"analyse": Stage("pipeline.inspection.analyse", WorkOptions, is_default=True)}
