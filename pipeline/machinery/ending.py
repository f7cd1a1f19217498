"""How the program starts, and how it ends early: in one line, at once, without leaving workers."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from types import FrameType
from typing import NoReturn

GOES_ON = "the same command goes on from what is finished"

PATIENCE = 10
"""Seconds in which the work may clear up after an interruption."""

NEEDED = 600_000_000
"""Bytes of address space with which a small dataset is made and described by two workers."""

AMPLE = 4_000_000_000
"""Bytes of address space from which on threads need not be spared."""

SPARING = {
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    "ARROW_IO_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}
"""Variables of the environment by which libraries take less address space, each thread 40 MB."""

STARTING = "starting ..."
"""What a terminal shows while libraries are imported, which takes seconds."""

_WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


def show_start(*, started: bool = False) -> None:
    """Show that the program starts, in a line that what comes next replaces; or remove it."""
    if sys.stderr is not None and sys.stderr.isatty():
        shown = " " * len(STARTING) if started else STARTING
        sys.stderr.write(f"{shown}\r")
        sys.stderr.flush()


def end(status: int, line: str = "") -> NoReturn:
    """Print a line on standard error, stop the workers and end.

    What libraries do when the interpreter ends is left out: it may wait for minutes for workers
    that have nothing to do, and crashes if there is no memory.
    """
    try:
        if line and sys.stderr is not None:
            after_progress = "\n" if sys.stderr.isatty() else ""
            sys.stderr.write(f"{after_progress}{line}\n")
            sys.stderr.flush()
        from multiprocessing import active_children  # Not before signals are answered.

        for worker in active_children():
            worker.terminate()
    finally:
        os._exit(status)


def lacks_memory(error: BaseException) -> bool:
    """Return whether an error, or one that caused it, says that there is not enough memory.

    A library that cannot be loaded, a thread that cannot be started and a compressor have other
    types; Arrow's error is a MemoryError. The cause of an error of a worker is a text.
    """
    signs = (
        "failed to map segment",
        "allocate memory",
        "Allocation error",
        "can't start new thread",
        "launch worker thread",
        "malloc of size",
        "MemoryError",
    )
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError) or any(sign in str(cause) for sign in signs):
            return True
        cause = cause.__cause__ or cause.__context__
    return False


def limit_of_memory() -> float:
    """Return the bytes of address space that this process may take, infinity for no limit."""
    if sys.platform == "win32":
        return inf
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return inf if limit == resource.RLIM_INFINITY else limit


def end_if_short_of_memory() -> None:
    """Let libraries spare address space if it is limited, and end if it is too small for them.

    Without memory they crash, and each thread and worker says so in lines of its own.
    """
    limit = limit_of_memory()
    if limit >= AMPLE:
        return
    for name, value in SPARING.items():
        os.environ.setdefault(name, value)
    if limit < NEEDED:
        needed, there = NEEDED // 1_000_000, limit // 1_000_000
        end(1, f"error: about {needed} MB of address space are needed: ulimit -v allows {there} MB")


def end_without_output(error: OSError) -> NoReturn:
    """End because standard output cannot be written to; silently, if its reader has gone."""
    line = f"error: {error.filename or 'standard output'}: {error.strerror or error}"
    end(1, "" if isinstance(error, BrokenPipeError) else line)


def end_interrupted(number: int = signal.SIGINT, _frame: FrameType | None = None) -> NoReturn:
    """End because of a signal, with the exit status that shells give for it."""
    end(128 + number, f"{_WORDS[signal.Signals(number)]}: {GOES_ON}")


def interrupt(number: int, _frame: FrameType | None = None) -> NoReturn:
    """Raise KeyboardInterrupt for a signal, so that the work clears up.

    Libraries may swallow the exception, so a second signal, or a few seconds, end the program.
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


@contextmanager
def ctrl_c_held_back() -> Iterator[None]:
    """Hold Ctrl-C back within the context, and for ever in processes that are started there.

    They get it from a terminal like their parent, and would all explain it.
    """
    if sys.platform == "win32":
        yield
        return
    from multiprocessing.resource_tracker import ensure_running

    ensure_running()  # Where it is first needed it would let signals through.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
