"""Locks on folders, and folders of ours that are not links."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TypeVar

from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import AnyPath, File
from pipeline.machinery.console import say

Place = TypeVar("Place", Path, AnyPath)


def held(folder: AnyPath, name: str) -> AbstractContextManager[bool]:
    """Hold the lock of `folder / name` as `File.held` does; say so before waiting for it."""
    waiting = f"waiting for another process that works on {folder / name}"
    return File(folder).held(name, lambda: say(waiting))


def within(folder: Place, *names: str) -> Place:
    """Return a folder inside a folder of ours, for files to be written to or removed from.

    Args:
        folder: The folder of ours, which may be a link.
        names: The names of the folders on the way, and of the folder itself.

    Raises:
        DatasetError: One of them is a link: what is behind it is not ours.
    """
    for name in names:
        folder = folder / name
        if folder.is_symlink():
            reason = "is a link, and nothing is written through it"
            raise DatasetError(f"{folder} {reason}: put a folder in its place, or remove it")
    return folder
