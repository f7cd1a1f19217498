"""The options of the stage `publish`."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.config.option import option

_ID = r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*"


@dataclass(frozen=True)
class PublishOptions:
    """Where and how a dataset is published."""

    repo_id: str = option(
        "",
        "dataset on the Hub, such as user/labyrinth",
        like=(_ID, "the id of the dataset on the Hub, such as user/labyrinth"),
    )
    version: str = option(
        "",
        "tag of the release, such as 1.0.0",
        like=(r"\d+\.\d+\.\d+", "three numbers, such as 1.0.0"),
    )
    dry_run: bool = option(False, "say what would be added, kept and deleted, and change nothing")
    private: bool = option(False, "make the dataset private, if it has to be made")
    branch: str = option(
        "main", "branch to release on", like=(r"[\w./-]+", "the name of a branch, such as main")
    )
    create_pr: bool = option(False, "open a pull request instead")
    collection: str | None = option(None, "title of a collection on the Hub that the dataset joins")
