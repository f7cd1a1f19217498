"""Folders that are made beside their place, and appear there whole."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path


def wait_for_disk(folder: Path) -> None:
    """Wait until a folder and all that is in it would survive a power failure."""
    for path in [*folder.rglob("*"), folder]:
        _wait(path)


def move_into_place(made: Path, folder: Path) -> None:
    """Move a folder to its place, in which another may be.

    After a crash on the way, `recover` puts the other one back.
    """
    replaced = _replaced(folder)
    if folder.exists():
        _remove(replaced)
        folder.replace(replaced)
    made.replace(folder)
    _remove(replaced)
    _wait(folder.parent)


def recover(folder: Path) -> None:
    """Put a folder back that a crash in `move_into_place` displaced."""
    replaced = _replaced(folder)
    if replaced.exists() and not folder.exists():
        replaced.replace(folder)
    _remove(replaced)


def _wait(path: Path) -> None:
    if sys.platform == "win32":
        return  # Folders cannot be opened there.
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError:
        if not path.is_dir():  # Some file systems cannot do it for folders.
            raise
    finally:
        os.close(descriptor)


def _replaced(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.replaced")


def _remove(folder: Path) -> None:
    """Remove a folder, or a link, which earlier versions have left in place of one."""
    if folder.is_symlink():
        folder.unlink()
    else:
        shutil.rmtree(folder, ignore_errors=True)
