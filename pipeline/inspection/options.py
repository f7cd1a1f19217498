"""The stage `analyse`, and its options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from pipeline.config.errors import check
from pipeline.config.option import option
from pipeline.config.options import WorkOptions
from pipeline.config.stage import Job, Stage


@dataclass(frozen=True)
class LeakageOptions:
    """A dataset to analyse instead of the dataset of the run."""

    source: str | None = option(
        None,
        "dataset to analyse instead: a .labyrinth or .npy file, a folder of such files by split, "
        "or a dataset with the column info, in a folder or on the Hub",
    )
    config: str | None = option(None, "config of that dataset, if it has several")


@dataclass(frozen=True)
class AnalyseOptions(WorkOptions):
    """What is analysed."""

    leakage: LeakageOptions = field(default_factory=LeakageOptions)


def _check(job: Job[AnalyseOptions], stages: Sequence[str]) -> None:  # noqa: ARG001
    asked = job.options.leakage
    check(
        asked.config is None or asked.source is not None,
        f"leakage.config={asked.config}: give leakage.source, too",
    )


STAGES = {
    "analyse": Stage(
        "pipeline.inspection.analyse",
        AnalyseOptions,
        _check,
        headings={"Analysis, by stages=analyse": AnalyseOptions},
    )
}
