"""Builds that something happens to, or that end, at a given moment."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from labyrinth_core.data import Shard
from labyrinth_core.folders import LocalFolder
from pipeline.generation import build
from support.crashing import CrashError


@contextmanager
def before_each_shard(act: Callable[[], None]) -> Iterator[None]:
    """Let something happen before each shard is made."""
    make_shard = build.make_shard

    def make(job: build.ShardJob) -> Shard:
        act()
        return make_shard(job)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "make_shard", make)
        yield


@contextmanager
def crash(moment: str) -> Iterator[None]:
    """End a build before or after the move into place, or while a file of this name is written."""
    move, replace = LocalFolder.complete, Path.replace

    def crashing_move(place: LocalFolder, shards: Path) -> None:
        if moment == "after the move":
            move(place, shards)
        raise CrashError

    def crashing_replace(file: Path, target: Path) -> Path:
        if target.name == moment:
            raise CrashError
        return replace(file, target)

    with pytest.MonkeyPatch.context() as patch:
        if moment.endswith("the move"):
            patch.setattr(LocalFolder, "complete", crashing_move)
        else:
            patch.setattr(Path, "replace", crashing_replace)
            patch.setattr(Path, "unlink", lambda *_, **__: None)  # No time to tidy up.
        with pytest.raises(CrashError):
            yield
