"""The stages `card` and `publish`, and their options."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from pipeline.config import (
    ExportOptions,
    Job,
    SourceOptions,
    Stage,
    TrainingOptions,
    WorkOptions,
    check,
    option,
)

LOOK = "stages=report", "look at it in a browser"
LEARN = "stages=train,evaluate method=bc", "train a policy on it"
"""What to do with a dataset, and why; no report is made of one in an object store."""

_ID = r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*"


def _id(kind: str, purpose: str, example: str) -> Any:
    """Declare an option for the id of a repository on the Hub, empty by default."""
    return option(
        "",
        f"{kind} on the Hub{purpose}, such as {example}",
        like=(f"({_ID})?", f"the id of a {kind} on the Hub, such as {example}"),
    )


@dataclass(frozen=True)
class PublishOptions:
    """Where and how a dataset, its export and environment, and a policy are published."""

    repo_id: str = _id("dataset", " to publish to", "user/labyrinth")
    model: str = _id(
        "model", " to publish the trained policy of method, size etc. to", "user/planner-5x5"
    )
    export: str = _id("dataset", " to publish the export to", "user/labyrinth-lerobot")
    env: str = _id(
        "model",
        " to publish the environment of the dataset's labyrinths to, for LeRobot's EnvHub",
        "user/labyrinth",
    )
    version: str = option(
        "",
        "tag of the release, such as 1.0.0",
        like=(r"((0|[1-9]\d*)(\.(0|[1-9]\d*)){2})?", "three numbers, such as 1.0.0"),
    )
    dry_run: bool = option(False, "only print what would be added, kept and deleted")
    private: bool = option(False, "make the repository private if it is created")


@dataclass(frozen=True)
class PublishStageOptions(TrainingOptions, WorkOptions):
    """What is published, and the run and the export that are meant."""

    publish: PublishOptions = field(default_factory=PublishOptions)
    # Its format is needed only with publish.export.
    export: ExportOptions = field(default_factory=ExportOptions, metadata={"is_checked": False})

    @property
    def dataset_on_hub(self) -> tuple[str, str | None]:
        """The Hub id and the revision of the dataset behind a published policy or environment."""
        if self.publish.repo_id:
            return self.publish.repo_id, self.publish.version
        return str(self.dataset), self.revision


def _check_card(job: Job[WorkOptions], stages: Sequence[str]) -> None:
    if job.names_dataset and "build" not in stages:
        job.require_dataset()


def _check_publish(job: Job[PublishStageOptions], stages: Sequence[str]) -> None:
    options, publish = job.options, job.options.publish
    _ = job.local_dir  # Raises a ConfigError if the folder is in an object store.
    if publish.model:
        options.check_training()
    of_dataset = bool(publish.model or publish.env)
    check(
        of_dataset or bool(publish.repo_id or publish.export),
        "publish.repo_id=: give the id of the dataset on the Hub, such as user/labyrinth; or "
        "publish.model, publish.export or publish.env",
    )
    check(publish.version != "", "publish.version=: give three numbers, such as 1.0.0")
    if publish.export:
        _check_released(options.export)
    check(
        bool(publish.repo_id)
        or not of_dataset
        or re.fullmatch(_ID, options.dataset or "", re.ASCII) is not None,
        f"dataset={options.dataset or ''}: give the id on the Hub of the dataset that the policy "
        "or the environment belongs to, such as user/labyrinth",
    )
    check(
        not publish.model or options.is_network_known,
        f"publish.model={publish.model}: policies of method={options.method_name} cannot be "
        "published, because load_policy cannot make their network",
    )
    if publish.repo_id:  # A policy's dataset, for example, is on the Hub.
        _check_card(job, stages)


def _check_released(export: ExportOptions) -> None:
    """Raise a ConfigError if an export cannot be published."""
    export.check()
    check(
        export.format in export.RELEASED,
        f"export.format={export.format}: publish.export releases {' and '.join(export.RELEASED)}, "
        "whose libraries read the Hub",
    )
    check(
        export.format != "lerobot" or len(export.splits) == 1,
        f"export.splits=[{', '.join(export.splits)}]: a repository holds one LeRobot dataset, so "
        "publish.export releases one split; give it, such as 'export.splits=[train]'",
    )


def _after_publish(job: Job[PublishStageOptions], stages: Sequence[str]) -> tuple[str, ...]:  # noqa: ARG001
    publish = job.options.publish
    takes = {
        "load_transitions takes the id of the dataset": publish.repo_id,
        "load_policy takes the id of the policy": publish.model,
    }
    lines = [f"Next: {line}, from any machine." for line, id_ in takes.items() if id_]
    return () if publish.dry_run or not lines else ("\n".join(lines),)


def _after_card(job: Job[WorkOptions], stages: Sequence[str]) -> tuple[str, ...]:
    if "build" not in stages:
        return ()
    return LOOK if isinstance(job.data_dir, Path) else LEARN


def _idle(options: Any) -> dict[str, str]:
    """Return the options of a run and of an export, if neither is published."""
    publish = options.publish
    idle: dict[str, str] = {}
    of_dataset = {each.name for each in fields(SourceOptions)}
    if not publish.model:
        of_run = {each.name for each in fields(TrainingOptions)} - of_dataset
        idle |= dict.fromkeys(of_run, "with publish.model")
    if not publish.export:
        idle["export"] = "with publish.export"
    if not (publish.model or publish.export or publish.env):
        idle |= dict.fromkeys(of_dataset, "with publish.model, publish.export or publish.env")
    return idle


STAGES = {
    "card": Stage(
        "pipeline.release.card", WorkOptions, _check_card, next_step=_after_card, is_default=True
    ),
    "publish": Stage(
        "pipeline.release.publish",
        PublishStageOptions,
        _check_publish,
        headings={"Publishing, by stages=publish": PublishStageOptions},
        next_step=_after_publish,
        idle=_idle,
    ),
}
