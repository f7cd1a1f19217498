"""The stage `results`, and its options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.config.option import check_options
from pipeline.config.options import ResultsFolderOption, RunFolderOption, SourceOptions
from pipeline.config.stage import Job, Stage


@dataclass(frozen=True)
class ResultsOptions(SourceOptions, RunFolderOption, ResultsFolderOption):
    """Where results are read and written, and the dataset that they are checked against."""


def _check(job: Job[ResultsOptions], stages: Sequence[str]) -> None:  # noqa: ARG001
    check_options(job.options, ResultsOptions)


STAGES = {
    "results": Stage(
        "pipeline.results.results",
        ResultsOptions,
        _check,
        headings={"Results, by stages=results": ResultsOptions},
    )
}
