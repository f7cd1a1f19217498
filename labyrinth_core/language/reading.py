"""Files of others: whether a file is a regular one."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import TypeVar

AnyPath = TypeVar("AnyPath")


def regular_file(path: AnyPath) -> AnyPath:
    """Return the path of a file that is to be read; one of an object store as it is.

    Raises:
        OSError: A pipe or a device is there, from which bytes may come for ever, or never.
    """
    if isinstance(path, Path) and path.exists() and not (path.is_file() or path.is_dir()):
        raise OSError(errno.EINVAL, "is a pipe or a device, not a regular file", str(path))
    return path
