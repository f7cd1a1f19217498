"""An ordered map over items: in this process, in several, or on a cluster.

It runs on joblib's process pool, or on its backends for Dask and Ray. Within `cluster`, every
`ordered_map` runs on that cluster.
"""

from __future__ import annotations

import logging
import os
import socket
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sized
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from typing import Any, TypeVar

from labyrinth_core.data.errors import DatasetError, one_line
from pipeline.config.errors import ConfigError
from pipeline.machinery.ending import ctrl_c_held_back
from pipeline.machinery.worker import begin_worker, shared_count

Item = TypeVar("Item")
Result = TypeVar("Result")

LOSSES = 3
"""The number of times in a row that workers may be lost."""

Losses = tuple[type[Exception], ...]
"""The errors that a backend raises when a worker is lost."""


@dataclass
class _Cluster:
    """The cluster that `ordered_map` runs on."""

    executor: str
    address: str | None
    """That of a running cluster; None for one that is started."""
    stack: ExitStack
    """Ends the cluster when it is closed."""
    processes: int = 0
    lost: Losses = ()

    def provide(self, workers: int) -> None:
        """Start the cluster, or start it again, if it has fewer processes than `workers`."""
        if workers <= self.processes:
            return
        self.stack.close()
        start = {"dask": _dask, "ray": _ray}[self.executor]
        try:
            options, self.lost = start(self.stack, workers, self.address)
        except (OSError, ValueError, RuntimeError) as error:
            place = f" executor_address={self.address}" if self.address else ""
            raise ConfigError(f"executor={self.executor}{place}: {one_line(error):.300}") from error
        from joblib import parallel_config

        self.stack.enter_context(parallel_config(backend=self.executor, **options))
        self.processes = workers


_LOST: Losses = (BrokenExecutor,)
_cluster: ContextVar[_Cluster | None] = ContextVar("cluster", default=None)


@contextmanager
def cluster(executor: str, workers: int, address: str | None = None) -> Iterator[None]:
    """Let `ordered_map` run on an executor within the context.

    A new cluster is started when there is work for it, with no more processes than items of work.

    Args:
        executor: local, dask or ray.
        workers: The largest number of processes that will be used.
        address: The address of a running cluster to use instead. Its machines have to see the
            dataset's folder under the same name.

    Raises:
        ConfigError: The executor is not installed, or its cluster cannot be reached.
    """
    if executor == "local":
        yield
        return

    try:
        import_module({"dask": "distributed", "ray": "ray"}[executor])
    except ImportError as error:
        install = f"pip install 'labyrinth-datasets[{executor}]'"
        raise ConfigError(f"executor={executor} is not installed: {install}") from error
    with ExitStack() as stack:
        there = _Cluster(executor, address, stack)
        if address is not None:
            there.provide(workers)
        token = _cluster.set(there)
        try:
            yield
        finally:
            _cluster.reset(token)


def _dask(stack: ExitStack, workers: int, address: str | None) -> tuple[dict[str, Any], Losses]:
    import distributed

    # It logs each worker that comes or goes.
    logging.getLogger("distributed").setLevel(logging.ERROR)
    place: Any = address
    if address is not None:
        # The number of frames of a message comes first.
        _check_listened_at(address, lambda came: int.from_bytes(came[:8], "little") < 1_000)
    else:
        place = stack.enter_context(
            distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",  # None is a port that may be taken.
                silence_logs=logging.ERROR,
            )
        )
    client = stack.enter_context(distributed.Client(place, set_as_default=False))
    return {"client": client}, (distributed.KilledWorker,)


def _ray(stack: ExitStack, workers: int, address: str | None) -> tuple[dict[str, Any], Losses]:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if address and ":" in address:  # Others are names that Ray knows, such as auto.
        # gRPC begins with a frame of HTTP/2 that has settings.
        _check_listened_at(address, lambda came: came[3:4] == b"\x04")
    import ray
    from ray.exceptions import OutOfMemoryError, RayActorError, WorkerCrashedError
    from ray.util.joblib import register_ray

    own = {"num_cpus": workers, "include_dashboard": False} if address is None else {}
    options = {"log_to_driver": False, "logging_level": logging.ERROR, **own}
    ray.init(address=address or "local", **options)
    stack.callback(ray.shutdown)
    processors = int(ray.cluster_resources().get("CPU", 0))
    if workers > processors:
        raise ValueError(f"workers={workers}: the cluster has room for {processors}")
    register_ray()
    return {}, (OutOfMemoryError, RayActorError, WorkerCrashedError)


def _check_listened_at(address: str, is_greeting: Callable[[bytes], bool]) -> None:
    """Raise an error unless a cluster listens at an address; the clients would try for minutes.

    Args:
        address: The address, with a port.
        is_greeting: Returns whether the first nine bytes that come are those of a cluster, which
            greets whoever connects.

    Raises:
        ValueError: It is no address.
        OSError: Nothing listens there, or something else.
    """
    protocol, _, place = address.rpartition("://")
    host, _, port = place.partition("/")[0].rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65_535:
        raise ValueError("give the address of a cluster with its port, such as 10.0.0.1:8786")
    with socket.create_connection((host.strip("[]"), int(port)), timeout=10) as connection:
        if protocol in ("", "tcp", "ray"):  # Others are encrypted.
            with suppress(TimeoutError):
                if is_greeting(connection.recv(9, socket.MSG_WAITALL)):
                    return
            raise ConnectionError("what listens there does not greet like a cluster")


def ordered_map(
    function: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Iterator[Result]:
    """Yield `function(item)` for each item, in their order, as they become ready.

    The items of a lost worker are done by another.

    Args:
        function: Picklable, and pure: it may run in another process, and again.
        items: Its arguments; each is taken when a worker is free.
        workers: Processes, of which no more are used than there are items in a list; with 1, and
            no cluster, everything happens in this one.

    Raises:
        DatasetError: Workers were lost more than `LOSSES` times in a row.
    """
    if isinstance(items, Sized):
        workers = min(workers, len(items))
    there = _cluster.get()
    if there is not None and workers:
        there.provide(workers)
    elif workers <= 1:
        yield from map(function, items)
        return
    backend, lost = ("local", _LOST) if there is None else (there.executor, there.lost)
    source = iter(items)
    again: deque[Item] = deque()  # Taken back from lost workers.
    out: deque[Item] = deque()  # Given to workers, no result yet.
    errors: list[Exception] = []

    def feed() -> Iterator[Item]:
        try:
            while again:
                out.append(again.popleft())
                yield out[-1]
            for item in source:
                out.append(item)
                yield item
        except Exception as error:  # joblib, which asks in a thread of its own, would lose it.
            errors.append(error)

    lost_in_a_row = 0
    while True:
        try:
            with closing(_results(function, feed(), workers, backend)) as results:
                for result in results:
                    out.popleft()
                    lost_in_a_row = 0
                    yield result
            break
        except lost as error:
            lost_in_a_row += 1
            if lost_in_a_row > LOSSES:
                raise DatasetError(
                    f"workers were lost {lost_in_a_row} times in a row, killed perhaps for want of "
                    "memory: the same command goes on from what is finished; try fewer workers"
                ) from error
            again.extendleft(reversed(out))
            out.clear()
    if errors:
        raise errors[0]


def _results(
    function: Callable[[Item], Result], feed: Iterable[Item], workers: int, backend: str
) -> Generator[Result]:
    from joblib import Parallel, delayed

    if backend == "ray":  # It returns no result before all are there, so it gets a few at a time.
        with Parallel(n_jobs=workers, batch_size=1) as parallel:
            while part := list(islice(feed, 4 * workers)):
                yield from parallel(delayed(function)(item) for item in part)
        return
    own = {}
    try:
        if backend == "local":
            own = {"initializer": begin_worker, "initargs": (os.getpid(), shared_count())}
        parallel = Parallel(n_jobs=workers, return_as="generator", batch_size=1, **own)
        with ctrl_c_held_back():  # It starts the processes.
            results = parallel(delayed(function)(item) for item in feed)
    except OSError as error:
        raise ConfigError(
            f"workers={workers}: processes cannot be started ({one_line(error):.200}): they need "
            "shared memory, /dev/shm on Linux, and a folder for temporary files"
        ) from error
    with closing(results):
        yield from results
