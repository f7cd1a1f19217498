"""Items made before they are wanted: in a thread meanwhile, or some at a time."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

Item = TypeVar("Item")


def prefetched(items: Generator[Item], ahead: int) -> Generator[Item]:
    """Yield the items of a generator, in order; it runs in a thread and is `ahead` of what is read.

    What it raises is raised here, in its place. When nobody reads on, by `close`, `break` or an
    error, the generator is closed and the thread ended before this returns.

    Args:
        items: What is run; it belongs to the thread from the first `next` on.
        ahead: Items that may wait, 1 or more.
    """
    end = object()
    thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="prefetch")
    try:
        waiting = deque(thread.submit(next, items, end) for _ in range(ahead))
        while (item := waiting.popleft().result()) is not end:
            waiting.append(thread.submit(next, items, end))
            yield item  # type: ignore[misc]
    finally:
        thread.shutdown(cancel_futures=True)
        items.close()


def batched(items: Iterable[Item], count: int) -> Iterator[Item]:
    """Yield the items, made `count` at a time.

    Between two stages it makes the processor do the same for long, which it does quicker.
    """
    iterator = iter(items)
    while batch := list(islice(iterator, count)):
        yield from batch
