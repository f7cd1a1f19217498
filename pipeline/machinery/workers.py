"""Worker processes when the program is interrupted or ends."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

GOES_ON = "run the same command again to resume"
"""Advice for an interrupted command, whose finished work is kept."""

LOOKED_AT = 0.5
"""Seconds between a worker's checks that its parent is alive."""


def end_with_parent(parent: int) -> None:
    """End this process soon after its parent process, whose id is `parent`, has ended.

    joblib's workers would wait five minutes for more work.
    """
    never = threading.Event()

    def watch() -> None:
        # The system gives an orphan another parent.
        while os.getppid() == parent:
            never.wait(LOOKED_AT)
        os._exit(1)

    threading.Thread(target=watch, name="watch", daemon=True).start()


@contextmanager
def ctrl_c_held_back() -> Iterator[None]:
    """Block Ctrl-C within the context, and permanently in processes that are started there.

    A terminal sends Ctrl-C to all of them, and each would print an explanation.
    """
    if sys.platform == "win32":
        yield
        return
    from multiprocessing.resource_tracker import ensure_running

    ensure_running()  # If it started later, it would unblock the signal.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
