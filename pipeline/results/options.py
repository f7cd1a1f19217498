"""The stage `results`, and its options."""

from __future__ import annotations

from dataclasses import dataclass, field

from pipeline.config.option import option
from pipeline.config.options import ResultsFolderOption, RunFolderOption, SourceOptions, WorkOptions
from pipeline.config.stage import Stage


@dataclass(frozen=True)
class CheckOptions:
    """How results are checked."""

    replay: bool = option(
        False, "play the policy of each results file again, and refuse what differs"
    )


@dataclass(frozen=True)
class ResultsOptions(SourceOptions, RunFolderOption, ResultsFolderOption, WorkOptions):
    """Where results are read and written, and what they are checked against."""

    results: CheckOptions = field(default_factory=CheckOptions)


STAGES = {
    "results": Stage(
        "pipeline.results.results",
        ResultsOptions,
        headings={"Results, by stages=results": ResultsOptions},
    )
}
