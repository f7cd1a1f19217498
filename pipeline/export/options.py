"""The stage `export`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from pipeline.config.export import ExportOptions
from pipeline.config.option import check_options
from pipeline.config.options import OverwriteOption, SourceOptions
from pipeline.config.stage import Job, Stage


@dataclass(frozen=True)
class ExportStageOptions(SourceOptions, OverwriteOption):
    """What is exported, and how."""

    export: ExportOptions = field(default_factory=ExportOptions)


def _check(job: Job[ExportStageOptions], stages: Sequence[str]) -> None:  # noqa: ARG001
    check_options(job.options.export, ExportOptions, "export.")


STAGES = {
    "export": Stage(
        "pipeline.export.stage",
        ExportStageOptions,
        _check,
        headings={"Export, by stages=export": ExportStageOptions},
    )
}
