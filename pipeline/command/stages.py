"""The stages of the program, by the names of the folders that declare them.

To take a wing out, delete its folder, its tests and its name here.
"""

from importlib import import_module

from pipeline.config import Stage

WINGS = (
    "generation",
    "questions",
    "inspection",
    "release",
    "report",
    "export",
    "training",
    "evaluation",
    "results",
    "certify",
    "season",
)
"""The folders whose `options.py` declares `STAGES`."""


STAGES: dict[str, Stage] = {}
"""Stage -> its declaration, in the order of `--help`."""

for wing in WINGS:
    STAGES |= import_module(f"pipeline.{wing}.options").STAGES
