"""The options of the stage `publish`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from labyrinth_core.policies.spec import ENCODERS, OWN
from pipeline.config.errors import check, listed
from pipeline.config.export import RELEASED, ExportOptions
from pipeline.config.option import check_options, option
from pipeline.config.training import TrainingOptions

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
        like=(r"\d+\.\d+\.\d+", "three numbers, such as 1.0.0"),
    )
    dry_run: bool = option(False, "only print what would be added, kept and deleted")
    private: bool = option(False, "make the repository private if it is created")


def check_publish(
    publish: PublishOptions, export: ExportOptions, training: TrainingOptions
) -> None:
    """Raise a ConfigError if an option for publishing is invalid or missing.

    Args:
        publish: The options of publishing.
        export: The options of the export to publish.
        training: The options of the run whose policy is published, and of the dataset.
    """
    of_dataset = bool(publish.model or publish.env)
    check(
        of_dataset or bool(publish.repo_id or publish.export),
        "publish.repo_id=: give the id of the dataset on the Hub, such as user/labyrinth; or "
        "publish.model, publish.export or publish.env",
    )
    check_options(publish, PublishOptions, "publish.")
    if publish.export:
        _check_released(export)
    check(
        bool(publish.repo_id)
        or not of_dataset
        or re.fullmatch(_ID, training.dataset or "", re.ASCII) is not None,
        f"dataset={training.dataset or ''}: give the id on the Hub of the dataset that the policy "
        "or the environment belongs to, such as user/labyrinth",
    )
    check(
        not publish.model or training.network in (*ENCODERS, *OWN),
        f"publish.model={publish.model}: policies of method={training.method_name} cannot be "
        "published, because load_policy cannot make their network",
    )


def _check_released(export: ExportOptions) -> None:
    """Raise a ConfigError if an export cannot be published."""
    check_options(export, ExportOptions, "export.")
    check(
        export.format in RELEASED,
        f"export.format={export.format}: publish.export releases {' and '.join(RELEASED)}, whose "
        "libraries read the Hub",
    )
    check(
        export.format != "lerobot" or len(export.splits) == 1,
        f"export.splits={listed(export.splits)}: a repository holds one LeRobot dataset, so "
        "publish.export releases one split; give it, such as 'export.splits=[train]'",
    )
