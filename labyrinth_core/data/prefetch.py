"""Items of a generator made ahead of their use, in a thread or in batches."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

Item = TypeVar("Item")


def prefetched(items: Generator[Item], ahead: int) -> Generator[Item]:
    """Yield the items of a generator in order, which runs ahead in a thread.

    Its errors are raised here, in their place. After `close`, `break` or an error the generator is
    closed and the thread ended before this returns.

    Args:
        items: The generator, which the thread owns from the first `next` on.
        ahead: The number of items that may wait, 1 or more.
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

    Between two stages this keeps the processor at one kind of work for longer, which is faster.
    """
    iterator = iter(items)
    while batch := list(islice(iterator, count)):
        yield from batch
