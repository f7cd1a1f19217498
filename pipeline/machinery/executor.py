"""An ordered map over pieces of work: in this process, in several, or on a cluster.

joblib does the work: its own processes, or its backends for Dask and Ray. Within `cluster`, every
`ordered_map` runs on that cluster.
"""

from __future__ import annotations

import logging
import os
import socket
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager
from contextvars import ContextVar
from itertools import islice
from typing import Any, Generic, TypeVar

from labyrinth_core.data.errors import DatasetError, one_line
from pipeline.config.errors import ConfigError

Item = TypeVar("Item")
Result = TypeVar("Result")

LOSSES = 3
"""Times in a row that workers may be lost before the map gives up."""

AHEAD = 4
"""Items for each worker that a backend without a stream of results is given at a time."""

_backend: ContextVar[str] = ContextVar("backend", default="local")


@contextmanager
def cluster(executor: str, workers: int, address: str | None = None) -> Iterator[None]:
    """Let `ordered_map` run on an executor within the context.

    Args:
        executor: local, dask or ray.
        workers: Processes of a cluster that is started for the time of the context.
        address: Of a running cluster, to be used instead. It has to see the same folder, under
            the same name.

    Raises:
        ConfigError: The executor is not installed, or its cluster is not to be had.
    """
    if executor == "local":
        yield
        return
    with ExitStack() as stack:
        try:
            options = {"dask": _dask, "ray": _ray}[executor](stack, workers, address)
        except ImportError as error:
            install = f"pip install 'labyrinth-datasets[{executor}]'"
            raise ConfigError(f"executor={executor} is not installed: {install}") from error
        except (OSError, ValueError, RuntimeError) as error:
            place = f" executor_address={address}" if address else ""
            raise ConfigError(f"executor={executor}{place}: {one_line(error):.300}") from error
        from joblib import parallel_config

        stack.enter_context(parallel_config(backend=executor, **options))
        token = _backend.set(executor)
        stack.callback(_backend.reset, token)
        yield


def _dask(stack: ExitStack, workers: int, address: str | None) -> dict[str, Any]:
    import distributed

    # Each coming and going of a worker is news to it.
    logging.getLogger("distributed").setLevel(logging.ERROR)
    place: Any = address
    if place is None:
        place = stack.enter_context(
            distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",  # None is a port that may be taken.
                silence_logs=logging.ERROR,
            )
        )
    return {"client": stack.enter_context(distributed.Client(place, set_as_default=False))}


def _ray(stack: ExitStack, workers: int, address: str | None) -> dict[str, Any]:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if address and ":" in address:  # Ray itself would try for minutes.
        host, _, port = address.rpartition(":")
        host = host.removeprefix("ray://").strip("[]")
        socket.create_connection((host, int(port)), timeout=10).close()
    import ray
    from ray.util.joblib import register_ray

    own = {"num_cpus": workers, "include_dashboard": False} if address is None else {}
    options = {"log_to_driver": False, "logging_level": logging.ERROR, **own}
    ray.init(address=address or "local", **options)
    stack.callback(ray.shutdown)
    processors = int(ray.cluster_resources().get("CPU", 0))
    if workers > processors:
        raise ValueError(f"workers={workers}: the cluster has room for {processors}")
    register_ray()
    return {}


class _Feed(Generic[Item]):
    """Items that are handed out one by one, and again if those who had them are lost.

    An error of their source ends them, and is kept: joblib asks for items in a thread of its own,
    where an error would be lost.
    """

    def __init__(self, items: Iterable[Item]) -> None:
        self._items = iter(items)
        self._again: deque[Item] = deque()
        self._out: deque[Item] = deque()
        """Those handed out of which no result has come, in order."""
        self.error: BaseException | None = None

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        try:
            item = self._again.popleft() if self._again else next(self._items)
        except StopIteration:
            raise
        except BaseException as error:
            self.error = error
            raise StopIteration from error
        self._out.append(item)
        return item

    def finish_first(self) -> None:
        """Forget the first of those that are out: its result is there."""
        self._out.popleft()

    def take_back(self) -> None:
        """Begin again with those that are out."""
        self._again, self._out = self._out + self._again, deque()


def ordered_map(
    function: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Iterator[Result]:
    """Yield `function(item)` for each item, in their order, as they become ready.

    What a lost worker had to do is done by another.

    Args:
        function: Picklable, and pure: it may run in another process, and again.
        items: What to call it with; taken from when a worker is free.
        workers: Processes; with 1, and no cluster, everything happens in this one.

    Raises:
        DatasetError: Workers were lost again and again.
    """
    backend = _backend.get()
    if backend == "local" and workers == 1:
        yield from map(function, items)
        return
    feed = _Feed(items)
    lost = _losses(backend)
    losses = 0
    while True:
        try:
            with closing(_results(function, feed, workers, backend)) as results:
                for result in results:
                    feed.finish_first()
                    losses = 0
                    yield result
        except lost as error:
            losses += 1
            if losses > LOSSES:
                raise DatasetError(
                    f"workers were lost {losses} times in a row, killed perhaps for want of "
                    "memory: the same command goes on from what is finished; try fewer workers"
                ) from error
            feed.take_back()
            continue
        if feed.error is not None:
            raise feed.error
        return


def _results(
    function: Callable[[Item], Result], feed: Iterable[Item], workers: int, backend: str
) -> Generator[Result]:
    from joblib import Parallel, delayed

    if backend == "ray":  # It gives no result before it has all.
        with Parallel(n_jobs=workers, batch_size=1) as parallel:
            while part := list(islice(feed, AHEAD * workers)):
                yield from parallel(delayed(function)(item) for item in part)
        return
    parallel = Parallel(n_jobs=workers, return_as="generator", batch_size=1)
    with closing(parallel(delayed(function)(item) for item in feed)) as results:
        yield from results


def _losses(backend: str) -> tuple[type[Exception], ...]:
    """Return what a backend raises when a worker is gone."""
    if backend == "dask":
        from distributed import KilledWorker

        return (KilledWorker,)
    if backend == "ray":
        from ray.exceptions import OutOfMemoryError, RayActorError, WorkerCrashedError

        return (OutOfMemoryError, RayActorError, WorkerCrashedError)
    from concurrent.futures.process import BrokenProcessPool

    return (BrokenProcessPool,)
