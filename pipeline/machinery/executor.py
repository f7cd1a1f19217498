"""An ordered map over items: in this process, or with joblib in several or on a Dask cluster.

Within `cluster`, every `ordered_map` runs on that cluster.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sized
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, closing, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, TypeVar

from labyrinth_core.errors import DatasetError, one_line
from pipeline.config import ConfigError
from pipeline.machinery.console import say

LOOKED_AT = 0.5
"""Seconds between a worker's checks that its parent is alive."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass
class _Dask:
    """The cluster that `ordered_map` runs on."""

    address: str | None
    """The address of a running cluster; None to start one."""
    stack: ExitStack
    """Closing it ends the cluster."""
    processes: int = 0
    client: Any = None

    @property
    def name(self) -> str:
        """The option that chooses the cluster."""
        return f"executor={self.address or 'dask'}"

    def provide(self, workers: int) -> None:
        """Start the cluster, or start it again, if it has fewer processes than `workers`."""
        if workers <= self.processes:
            return
        self.stack.close()
        try:
            self.client = _client(self.stack, workers, self.address)
        except (OSError, ValueError, RuntimeError) as error:
            raise ConfigError(f"{self.name}: {one_line(error):.300}") from error
        from joblib import parallel_config

        self.stack.enter_context(parallel_config(backend="dask", client=self.client))
        self.processes = workers

    def wait_for_worker(self) -> None:
        """Wait until the cluster has a worker; a cluster that adapts starts one for the probe."""
        try:
            if self.client.ncores():
                return
            say(f"waiting for a worker of {self.name}, as long as it takes")
            self.client.submit(os.getpid, pure=False).result()
        except OSError as error:
            raise ConfigError(f"{self.name}: {one_line(error):.300}") from error


_cluster: ContextVar[_Dask | None] = ContextVar("cluster", default=None)


@contextmanager
def cluster(executor: str, workers: int) -> Iterator[None]:
    """Run every `ordered_map` within the context on an executor.

    A new cluster starts when there is work for it, with no more processes than items of work.

    Args:
        executor: local, dask, or the address of a running Dask cluster, whose machines must have
            the dataset's folder at the same path.
        workers: The maximum number of processes.

    Raises:
        ConfigError: Dask is not installed, or its cluster cannot be reached.
    """
    if executor == "local":
        yield
        return
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        install = "pip install 'labyrinth-datasets[dask]'"
        raise ConfigError(f"executor={executor} needs dask: {install}") from error
    with ExitStack() as stack:
        dask = _Dask(None if executor == "dask" else executor, stack)
        if dask.address is not None:
            dask.provide(workers)
        token = _cluster.set(dask)
        try:
            yield
        finally:
            _cluster.reset(token)


def _client(stack: ExitStack, workers: int, address: str | None) -> Any:
    """Return a client of a running cluster, or of a new cluster that ends with the stack.

    Raises:
        ValueError: The address has no port.
        OSError: No process listens there.
    """
    import distributed

    # It logs each worker that comes or goes.
    logging.getLogger("distributed").setLevel(logging.ERROR)
    target: Any = address
    if address is not None:
        host, _, port = address.rpartition("://")[2].partition("/")[0].rpartition(":")
        if not host or not port.isdecimal() or int(port) > 65_535:
            raise ValueError("give the address of a cluster with its port, such as 10.0.0.1:8786")
        # If nothing listens, the client would end in a traceback.
        socket.create_connection((host.strip("[]"), int(port)), timeout=10).close()
    else:
        target = stack.enter_context(
            distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",  # None is a fixed port, which may be taken.
                silence_logs=logging.ERROR,
            )
        )
    return stack.enter_context(distributed.Client(target, set_as_default=False))


def ordered_map(
    function: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Iterator[Result]:
    """Yield `function(item)` for each item, in the order of the items, as results become ready.

    Args:
        function: A picklable, pure function: it may run in another process, and more than once.
        items: Its arguments; each is taken when a worker is free.
        workers: The number of processes, at most one for each item if `items` has a length. With
            1 and no cluster, everything runs in this process.

    Raises:
        ConfigError: The processes cannot be started, or no worker of the cluster came in time.
        DatasetError: A worker was lost.
    """
    if isinstance(items, Sized):
        workers = min(workers, len(items))
    dask = _cluster.get()
    if dask is not None and workers:
        dask.provide(workers)
        dask.wait_for_worker()
    elif workers <= 1:
        yield from map(function, items)
        return
    from joblib import Parallel, delayed

    errors: list[Exception] = []

    def feed() -> Iterator[Any]:
        try:
            for item in items:
                yield delayed(function)(item)
        except Exception as error:  # joblib iterates in another thread, and would lose it.
            errors.append(error)

    # Local workers do not notice by themselves that their parent was killed.
    own = {} if dask else {"initializer": end_with_parent, "initargs": (os.getpid(),)}
    try:
        parallel = Parallel(n_jobs=workers, return_as="generator", batch_size=1, **own)
        with ctrl_c_held_back():  # It starts the processes.
            results = parallel(feed())
    except OSError as error:
        if dask:
            raise ConfigError(f"{dask.name}: {one_line(error):.300}") from error
        raise ConfigError(
            f"workers={workers}: processes cannot be started ({one_line(error):.200}): they need "
            "shared memory, /dev/shm on Linux, and a folder for temporary files"
        ) from error
    try:
        with closing(results):
            yield from results
    except _losses(dask) as error:
        raise DatasetError(
            "a worker was lost, perhaps for lack of memory: try fewer workers; run the same "
            "command again to resume"
        ) from error
    if errors:
        raise errors[0]


def _losses(dask: _Dask | None) -> tuple[type[Exception], ...]:
    """Return the exceptions that mean that a worker was lost."""
    if dask is None:
        return (BrokenExecutor,)
    import distributed

    return (distributed.KilledWorker,)


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
