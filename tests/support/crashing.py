"""Processes that end before one of their changes of files, or at a moment of a build.

Also folders that cannot be renamed: in a lower layer of a container, or mount points.
"""

from __future__ import annotations

import errno
import os
import shutil
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from labyrinth_core.data import Shard
from labyrinth_core.folders import LocalFolder
from pipeline.generation import build


class CrashError(BaseException):
    """The end of a process, as far as its changes of files are concerned."""


class Crash:
    """Let the process end before one of the changes of files, counted from one."""

    def __init__(self, patch: pytest.MonkeyPatch, change: int) -> None:
        self.left = change
        for owner, name in (
            *((Path, name) for name in ("replace", "unlink", "mkdir")),
            *((shutil, name) for name in ("rmtree", "copy2")),
        ):
            patch.setattr(owner, name, self.before(getattr(owner, name)))

    def before(self, act: Callable[..., Any]) -> Callable[..., Any]:
        def acting(*given: Any, **options: Any) -> Any:
            self.left -= 1
            if self.left <= 0:  # Afterwards nothing is tidied up.
                raise CrashError
            return act(*given, **options)

        return acting


FILE_EVENTS = ("open", "os.mkdir", "os.remove", "os.rename", "os.rmdir", "shutil.rmtree")
"""What Python calls the operations that may change files."""


def killed_before(change: int, place: Path, act: Callable[[], object]) -> bool:
    """Do something in a process that is killed before one of its changes of files.

    Args:
        change: How many changes come before the kill.
        place: The folder whose changes count.
        act: What the process does.

    Returns:
        Whether it was killed, and not finished before.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Later versions of Python warn of threads.
        process = os.fork()
    if not process:
        left = change

        def kill(event: str, arguments: tuple[Any, ...]) -> None:
            nonlocal left
            if event in FILE_EVENTS and str(arguments[0]).startswith(str(place)):
                left -= event != "open" or "w" in str(arguments[1])
                if left < 0:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(kill)
        status = 1
        try:
            act()
            status = 0
        finally:
            os._exit(status)
    _, status = os.waitpid(process, 0)
    assert status in (0, signal.SIGKILL)
    return status != 0


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


ERRORS = (errno.EXDEV, errno.EBUSY)
"""What the system answers: the first in a lower layer, the second of a mount point."""


@contextmanager
def no_folder_is_renamed(error: int) -> Iterator[None]:
    """Let every renaming of a folder fail with an error of the system."""
    replace = Path.replace

    def failing(path: Path, target: Path) -> Path:
        if path.is_dir():
            raise OSError(error, os.strerror(error), str(path))
        return replace(path, target)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "replace", failing)
        yield
