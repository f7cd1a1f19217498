"""The stage `results`, and its options."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.config.options import (
    OverwriteOption,
    ResultsFolderOption,
    RunFolderOption,
    SourceOptions,
)
from pipeline.config.stage import Stage


@dataclass(frozen=True)
class ResultsOptions(SourceOptions, RunFolderOption, ResultsFolderOption, OverwriteOption):
    """Where results are read and written, and the dataset that they are checked against."""


STAGES = {
    "results": Stage(
        "pipeline.results.results",
        ResultsOptions,
        headings={"Results, by stages=results": ResultsOptions},
    )
}
