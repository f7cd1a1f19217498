"""The files of a folder, without those that other programs leave anywhere."""

from __future__ import annotations

import os
import stat
from fnmatch import fnmatchcase
from pathlib import Path, PurePath

LITTER = (
    *(".ds_store", "._*", "thumbs.db", "desktop.ini", ".directory", "__macosx"),
    *("@eadir", "@recycle", "#recycle", "$recycle.bin", "system volume information", "lost+found"),
    *(".trash*", ".stfolder", ".spotlight-v100", ".fseventsd", ".temporaryitems", ".appledouble"),
    *("#snapshot", "@recently-snapshot", ".snapshot", ".snapshots", ".@__thumb", ".syncthing.*"),
    *(".nfs*", ".fuse_hidden*"),
    *(".ipynb_checkpoints", "cache-*.arrow"),
)
"""Patterns, in lower case, of files and folders that desktops, storage servers, network file
systems and readers (Jupyter, `datasets`) leave anywhere."""


def is_litter(path: str | PurePath) -> bool:
    """Return whether a path relative to a folder matches `LITTER`, files that no user misses."""
    parts = [part.lower() for part in PurePath(path).parts]
    return any(fnmatchcase(part, pattern) for part in parts for pattern in LITTER)


def files_in(folder: Path) -> list[tuple[Path, str]]:
    """Return the paths of files in a folder and its sub-folders, sorted; [] if it does not exist.

    With each comes the reason why it cannot be read, empty for a regular file: a link that leads
    nowhere, a folder that cannot be listed. Files and folders whose names begin with a dot, such as
    `.git` or `.ipynb_checkpoints`, are skipped. Links are followed; below each entry of `folder`,
    a folder that links reach several times is listed once.
    """
    files: list[tuple[Path, str]] = []
    folders = [folder] if os.path.lexists(folder) else []
    listed: set[tuple[str, str]] = set()
    for each in folders:  # The list grows during the loop.
        try:
            paths = sorted(each.iterdir())
        except OSError as error:
            files.append((each, why_unreadable(each, error)))
            continue
        for path in paths:
            if path.name.startswith(".") or is_litter(path.name):
                continue
            try:
                mode = path.stat().st_mode
            except OSError as error:
                files.append((path, why_unreadable(path, error)))
                continue
            if stat.S_ISDIR(mode):
                key = path.relative_to(folder).parts[0], os.path.realpath(path)
                if key not in listed:
                    listed.add(key)
                    folders.append(path)
            else:
                files.append((path, "" if stat.S_ISREG(mode) else "it is not a regular file"))
    return sorted(files)


def why_unreadable(path: Path, error: OSError) -> str:
    """Return the reason of an error in one line; a link that leads nowhere is called that."""
    leads = "a link that leads nowhere: " if path.is_symlink() and not path.exists() else ""
    return leads + (error.strerror or str(error))
