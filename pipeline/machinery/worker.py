"""What a worker process on this machine does besides its work: it counts, and ends with its parent.

A worker counts what it has done of an item, so that a progress bar moves before the item is
finished. On a cluster nobody counts, and the bar moves with each item.
"""

from __future__ import annotations

import os
import threading
from functools import lru_cache
from typing import Any

PATIENCE = 0.5
"""Seconds between two looks at whether the parent is still there."""

_count: Any = None
"""The semaphore that a worker counts in; None in other processes."""
_total = 0
"""What this process counted, and what it has taken from the semaphore of its workers."""
_taking = threading.Lock()


@lru_cache(maxsize=1)
def shared_count() -> Any:
    """Return the semaphore that the workers of this process count in; it is none for a lock."""
    from joblib.externals.loky.backend.context import get_context

    return get_context("loky").Semaphore(0)


def begin_worker(parent: int, count: Any) -> None:
    """Prepare a worker: it counts in a semaphore, and ends when its parent has ended.

    Nothing else would end it soon: joblib's workers wait five minutes for more to do, as they
    cannot see that a parent was killed. Its tracker, which removes what is left in shared memory,
    ends after the last of them.
    """
    global _count
    _count = count
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


def count(amount: int) -> None:
    """Count so much as done, in a worker or in the only process."""
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
        while shared_count.cache_info().currsize and shared_count().acquire(False):
            _total += 1
        return _total
