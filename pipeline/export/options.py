"""The stage `export`."""

from __future__ import annotations

from dataclasses import dataclass, field

from pipeline.config import ExportOptions, SourceOptions, Stage, WorkOptions


@dataclass(frozen=True)
class ExportStageOptions(SourceOptions, WorkOptions):
    """What is exported, and how."""

    export: ExportOptions = field(default_factory=ExportOptions)


STAGES = {
    "export": Stage(
        "pipeline.export.stage",
        ExportStageOptions,
        headings={"Export, by stages=export": ExportStageOptions},
    )
}
