"""Start and early exit of the program: an exit prints one line, is immediate, and stops workers."""

from __future__ import annotations

import errno
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import NoReturn

_FAULTS = ("ENOSPC", "EDQUOT", "EFBIG", "EROFS", "EIO", "ESTALE", "ENOTCONN", "ETIMEDOUT")
FAULTS_OF_DISKS = frozenset(getattr(errno, each) for each in _FAULTS if hasattr(errno, each))
"""Error numbers of disks and network folders, which are not bugs of the program."""

GOES_ON = "run the same command again to resume"
"""Advice for an interrupted command, whose finished work is kept."""

PATIENCE = 10
"""Seconds that stages have to clean up after an interruption."""

STARTING = "starting ..."
"""What a terminal shows while libraries are imported, which takes seconds."""

_WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


def show_start(*, started: bool = False) -> None:
    """Show `STARTING` in a line that later output overwrites; with `started`, remove it."""
    if sys.stderr is not None and sys.stderr.isatty():
        shown = " " * len(STARTING) if started else STARTING
        sys.stderr.write(f"{shown}\r")
        sys.stderr.flush()


def end(status: int, line: str = "") -> NoReturn:
    """Print a line on standard error, stop the workers and exit.

    The exit handlers of libraries do not run: they may wait minutes for idle workers, and crash
    if memory is exhausted.
    """
    try:
        if line and sys.stderr is not None:
            after_progress = "\n" if sys.stderr.isatty() else ""
            sys.stderr.write(f"{after_progress}{line}\n")
            sys.stderr.flush()
        from multiprocessing import active_children  # Signal handlers come first.

        for worker in active_children():
            worker.terminate()
    finally:
        os._exit(status)


def end_without_output(error: OSError) -> NoReturn:
    """End because standard output cannot be written to; silently, if its reader has gone."""
    line = f"error: {error.filename or 'standard output'}: {error.strerror or error}"
    end(1, "" if isinstance(error, BrokenPipeError) else line)


def end_interrupted(number: int = signal.SIGINT, _frame: FrameType | None = None) -> NoReturn:
    """End because of a signal, with the exit status that shells use: 128 + `number`."""
    end(128 + number, f"{_WORDS[signal.Signals(number)]}: {GOES_ON}")


def interrupt(number: int, _frame: FrameType | None = None) -> NoReturn:
    """Raise KeyboardInterrupt for a signal, so that stages clean up.

    Libraries may swallow the exception, so a second signal or `PATIENCE` seconds end the program.
    """
    answer_signals(end_interrupted)
    if sys.platform != "win32":
        signal.signal(signal.SIGALRM, lambda *_: end_interrupted(number))
        signal.alarm(PATIENCE)
    raise KeyboardInterrupt(number)


def answer_signals(answer: Callable[[int, FrameType | None], None]) -> None:
    """Call a function for Ctrl-C and for SIGTERM, unless the caller of the program ignores them."""
    for number in _WORDS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, answer)
