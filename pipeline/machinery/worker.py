"""What a worker process on this machine does besides its work: it counts, and ends with its parent.

A worker counts the finished part of an item, so that a progress bar moves before the item is
finished. On a cluster the bar moves only when an item is finished.
"""

from __future__ import annotations

import os
import threading
from typing import Any

from pipeline.machinery.ending import AMPLE, limit_of_memory

PATIENCE = 0.5
"""Seconds between two looks at whether the parent is still there."""

_count: Any = None
"""In a worker, the semaphore that it counts in."""
_shared: Any = None
"""In a process that has started workers, the semaphore that they count in."""
_total = 0
"""What this process counted, and what it has taken from the semaphore of its workers."""
_taking = threading.Lock()


def shared_count() -> Any:
    """Return the semaphore that the workers of this process count in; make it the first time."""
    global _shared
    if _shared is None:
        from joblib.externals.loky.backend.context import get_context

        _shared = get_context("loky").Semaphore(0)
    return _shared


def begin_worker(parent: int, count: Any) -> None:
    """Prepare a worker: it counts in a semaphore, and ends when its parent has ended.

    Otherwise joblib's workers would wait five minutes for more work, since they do not see that
    their parent was killed. joblib's tracker, which removes what is left in shared memory, ends
    after the last worker.
    """
    global _count
    _count = count
    if limit_of_memory() < AMPLE:
        # It would explain at length that it has no memory; its parent does so in a line.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    end_with_parent(parent)


def end_with_parent(parent: int) -> None:
    """End this process soon after its parent, the process of that id, has ended."""
    never = threading.Event()

    def watch() -> None:
        # The system gives an orphan another parent.
        while os.getppid() == parent:
            never.wait(PATIENCE)
        os._exit(1)

    threading.Thread(target=watch, name="watch", daemon=True).start()


def count_done(amount: int) -> None:
    """Count an amount as done, in a worker or in the only process."""
    global _total
    if _count is None:
        with _taking:
            _total += amount
    else:
        for _ in range(amount):
            _count.release()


def counted() -> int:
    """Return what this process and its workers have counted so far."""
    global _total
    with _taking:
        while _shared is not None and _shared.acquire(False):
            _total += 1
        return _total
