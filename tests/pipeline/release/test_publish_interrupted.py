"""A release that is killed anywhere leaves the old one or the new one, and the next completes."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from hub.local_hub import LocalHub
from support.publishing import REPO, built, changes, held, kill_in, large, published

pytestmark = pytest.mark.slow


def test_a_first_release_that_is_killed_is_not_there_or_whole_and_sends_nothing_twice(
    local_hub: LocalHub, releasable: Path
) -> None:
    kill_in(local_hub, local_hub.faults.hold("PUT", "^/lfs/", skip=3), releasable, "1.0.0")
    assert held(local_hub) == {}
    assert len(local_hub.log.uploaded()) == 3
    committed = local_hub.faults.hold("POST", "/commit/", after=True)
    kill_in(local_hub, committed, releasable, "1.0.0")
    assert held(local_hub) == built(releasable)
    assert local_hub.refs(REPO).keys() == {"refs/heads/main"}
    asked = len(local_hub.log)
    printed = published(local_hub, releasable)
    assert "0 files to add" in printed
    assert "tagged 1.0.0" in printed
    assert [call.path.split("/")[-2] for call in changes(local_hub, asked)] == ["tag"]
    assert held(local_hub, "1.0.0") == held(local_hub) == built(releasable)
    assert len(local_hub.history(REPO)) == 2
    assert sorted(local_hub.log.uploaded()) == sorted(large(local_hub))


def test_a_further_release_that_is_killed_leaves_the_old_one_or_the_new_one_whole(
    released_hub: LocalHub, released: Path, other_shard: Path
) -> None:
    old, contents = held(released_hub), large(released_hub)
    shutil.rmtree(released / "2x3")
    shutil.copytree(other_shard / "2x3", released / "2x3")
    kill_in(released_hub, released_hub.faults.hold("POST", "/commit/"), released, "1.1.0")
    assert held(released_hub) == held(released_hub, "1.0.0") == old
    tagged = released_hub.faults.hold("POST", "/tag/", after=True)
    kill_in(released_hub, tagged, released, "1.1.0")
    assert "1.1.0 is published already" in published(released_hub, released, "1.1.0")
    assert held(released_hub, "1.0.0") == old
    assert held(released_hub, "1.1.0") == held(released_hub) == built(released) != old
    assert len(released_hub.history(REPO)) == 3

    # The one shard that differs, the table that counts its rows, and the pictures that show it.
    new = large(released_hub) - contents
    paths = [path for path, entry in released_hub.tree(REPO).items() if entry.sha256 in new]
    shards = sorted(path for path in paths if path.endswith(".parquet"))
    assert shards == ["2x3/labyrinths.parquet", "2x3/random-00000-of-00001.parquet"]
    assert sorted(released_hub.log.uploaded()) == sorted(new)
