"""Processes that end before one of their changes of files: by an exception, or killed."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


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
