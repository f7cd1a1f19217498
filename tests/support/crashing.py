"""A process that ends before one of its changes of files."""

from __future__ import annotations

import os
import shutil
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


def dies_at(change: int, act: Callable[[], object]) -> bool:
    """Do something in a process that ends before one of its changes; return whether it did."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Later versions of Python warn of threads.
        process = os.fork()
    if not process:
        status = 1
        try:
            Crash(pytest.MonkeyPatch(), change)
            act()
            status = 0
        except CrashError:
            status = 9
        finally:
            os._exit(status)
    _, status = os.waitpid(process, 0)
    assert os.waitstatus_to_exitcode(status) in (0, 9)
    return status != 0
