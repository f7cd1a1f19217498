"""A release that is killed anywhere leaves the old one or the new one, and the next completes."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import NamedTuple

import pytest
from hub.local_hub import LocalHub
from publishing import REPO, built, changes, held, kill_in, large, published

pytestmark = pytest.mark.slow


class Point(NamedTuple):
    """Where a release is killed: in a call, before or after the Hub has done what it asks."""

    method: str
    path: str
    after: bool = False
    skip: int = 0
    landed: bool = False
    """Whether the commit is on `main` by then."""


FIRST = (
    Point("GET", "/whoami-v2"),
    Point("POST", "/repos/create"),
    Point("POST", "/repos/create", after=True),
    Point("POST", "/preupload/", skip=2),
    Point("PUT", "^/lfs/", skip=3),
    Point("POST", "/commit/", after=True, landed=True),
)
SECOND = (
    Point("POST", "/commit/"),
    Point("HEAD", "/resolve/.*-00000-of-00001.parquet", skip=2, landed=True),
    Point("POST", "/tag/", landed=True),
    Point("POST", "/tag/", after=True, landed=True),
)


def kill_at(hub: LocalHub, point: Point, data_dir: Path, version: str) -> None:
    """Publish, and kill it at a point; then `main` is as it was, or as the folder is."""
    old = held(hub) if hub.has(REPO) else {}
    rule = hub.faults.hold(point.method, point.path, after=point.after, skip=point.skip)
    kill_in(hub, rule, data_dir, version)
    new = held(hub) if hub.has(REPO) else {}
    assert new == (built(data_dir) if point.landed else old), point


def test_releases_that_are_killed_at_ten_points_are_whole_and_completed(
    local_hub: LocalHub, releasable: Path, other_shard: Path
) -> None:
    for point in FIRST:
        kill_at(local_hub, point, releasable, "1.0.0")
    assert local_hub.refs(REPO).keys() == {"refs/heads/main"}
    asked = len(local_hub.log)
    printed = published(local_hub, releasable)
    assert "0 files to add" in printed
    assert "tagged 1.0.0" in printed
    assert [call.path.split("/")[-2] for call in changes(local_hub, asked)] == ["tag"]
    old = held(local_hub)
    assert held(local_hub, "1.0.0") == old == built(releasable)
    assert len(local_hub.history(REPO)) == 2
    contents = large(local_hub)
    assert sorted(local_hub.log.uploaded()) == sorted(contents)

    asked = len(local_hub.log)
    shutil.rmtree(releasable / "2x3")
    shutil.copytree(other_shard / "2x3", releasable / "2x3")
    for point in SECOND:
        kill_at(local_hub, point, releasable, "1.1.0")
    assert "1.1.0 is published already" in published(local_hub, releasable, "1.1.0")
    assert held(local_hub, "1.0.0") == old
    assert held(local_hub, "1.1.0") == held(local_hub) == built(releasable) != old
    assert len(local_hub.history(REPO)) == 3

    # The one shard that differs, the table that counts its rows, and the pictures that show it.
    new = large(local_hub) - contents
    paths = [path for path, entry in local_hub.tree(REPO).items() if entry.sha256 in new]
    shards = sorted(path for path in paths if path.endswith(".parquet"))
    assert shards == ["2x3/labyrinths.parquet", "2x3/random-00000-of-00001.parquet"]
    assert sorted(local_hub.log.uploaded(asked)) == sorted(new)
