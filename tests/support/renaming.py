"""Folders that cannot be renamed: in a lower layer of a container, or mount points."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

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
