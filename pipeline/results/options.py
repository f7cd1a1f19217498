"""The stage `results`, and its options."""

from __future__ import annotations

from dataclasses import dataclass, field

from pipeline.config import ResultFolderOptions, SourceOptions, Stage, WorkOptions, option


@dataclass(frozen=True)
class CheckOptions:
    """How results are checked."""

    replay: bool = option(
        False, "play the policy of each results file again, and refuse what differs"
    )


@dataclass(frozen=True)
class ResultsOptions(SourceOptions, ResultFolderOptions, WorkOptions):
    """Where results are read and written, and what they are checked against."""

    results: CheckOptions = field(default_factory=CheckOptions)


STAGES = {
    "results": Stage(
        "pipeline.results.results",
        ResultsOptions,
        headings={"Results, by stages=results": ResultsOptions},
    )
}
