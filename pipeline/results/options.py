"""The stage `results`, and its options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from pipeline.config.option import check_options, option
from pipeline.config.options import (
    OverwriteOption,
    ResultsFolderOption,
    RunFolderOption,
    SourceOptions,
)
from pipeline.config.stage import Job, Stage


@dataclass(frozen=True)
class CheckOptions:
    """How results are checked."""

    replay: bool = option(
        False, "play the policy of each results file again, and refuse what differs"
    )


@dataclass(frozen=True)
class ResultsOptions(SourceOptions, RunFolderOption, ResultsFolderOption, OverwriteOption):
    """Where results are read and written, and what they are checked against."""

    results: CheckOptions = field(default_factory=CheckOptions)


def _check(job: Job[ResultsOptions], stages: Sequence[str]) -> None:  # noqa: ARG001
    check_options(job.options.results, CheckOptions, "results.")


STAGES = {
    "results": Stage(
        "pipeline.results.results",
        ResultsOptions,
        _check,
        headings={"Results, by stages=results": ResultsOptions},
    )
}
