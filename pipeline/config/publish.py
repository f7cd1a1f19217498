"""The options of the stage `publish`: their schema, their checks, and the frozen object of them."""

from __future__ import annotations

import re
from dataclasses import dataclass

from pipeline.config.errors import check


@dataclass
class PublishConfig:
    """The schema of `publish`, for the stage of that name."""

    repo_id: str | None = None
    version: str | None = None
    dry_run: bool = False
    private: bool = False
    branch: str = "main"
    create_pr: bool = False
    collection: str | None = None


PUBLISH_OPTIONS = {
    "publish.repo_id": "dataset on the Hub, such as user/labyrinth",
    "publish.version": "tag of the release, such as 1.0.0",
    "publish.dry_run": "say what would be added, kept and deleted, and change nothing",
    "publish.private": "make the dataset private, if it has to be made",
    "publish.branch": "branch to release on",
    "publish.create_pr": "open a pull request instead",
    "publish.collection": "title of a collection on the Hub that the dataset joins",
}
"""What each option means, as `python run.py --help` and the README say it."""


@dataclass(frozen=True)
class PublishOptions:
    """Where and how to publish, checked."""

    repo_id: str
    version: str
    dry_run: bool = False
    private: bool = False
    branch: str = "main"
    create_pr: bool = False
    collection: str | None = None


def resolve_publish(config: PublishConfig) -> PublishOptions:
    """Return the options of the stage `publish`.

    Raises:
        ConfigError: One is impossible.
    """
    repo_id, version = config.repo_id or "", config.version or ""
    check(
        re.fullmatch(r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*", repo_id, re.ASCII) is not None,
        f"publish.repo_id={repo_id}: give the id of the dataset on the Hub, such as user/labyrinth",
    )
    check(
        re.fullmatch(r"\d+\.\d+\.\d+", version, re.ASCII) is not None,
        f"publish.version={version}: give three numbers, such as 1.0.0",
    )
    check(
        re.fullmatch(r"[\w./-]+", config.branch, re.ASCII) is not None,
        f"publish.branch={config.branch}: give the name of a branch, such as main",
    )
    return PublishOptions(**vars(config) | {"repo_id": repo_id, "version": version})
