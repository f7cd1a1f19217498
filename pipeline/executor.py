"""An ordered map over pieces of work, in this process or in several."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def ordered_map(
    function: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Iterator[Result]:
    """Yield `function(item)` for each item, in their order, as they become ready.

    Args:
        function: Picklable, and pure: it may run in another process.
        items: What to call it with; taken from when a worker is free.
        workers: Processes; with 1 everything happens in this one.
    """
    if workers == 1:
        yield from map(function, items)
        return
    from joblib import Parallel, delayed

    parallel = Parallel(n_jobs=workers, return_as="generator", batch_size=1)
    yield from parallel(delayed(function)(item) for item in items)
