"""The stage `report`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.config import Job, ResultFolderOptions, Stage, WorkOptions


@dataclass(frozen=True)
class ReportOptions(WorkOptions, ResultFolderOptions):
    """Where the runs and results of a report are."""


def _check(job: Job[ReportOptions], stages: Sequence[str]) -> None:
    _ = job.local_dir  # Raises a ConfigError if the folder is in an object store.
    if job.names_dataset and "build" not in stages:
        job.require_dataset()


STAGES = {"report": Stage("pipeline.report.report", ReportOptions, _check)}
