"""A submission: a policy and its files, pinned by a commit on the Hub or by their SHA-256."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from threading import Event, Timer
from typing import Any, NamedTuple

from numpy.typing import NDArray

from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import PolicyError
from labyrinth_core.policies import SECONDS, PolicyNameError, files_of
from labyrinth_core.world import Task
from pipeline.season.commitment import private_folder


class Submission(NamedTuple):
    """A policy to judge, and the files that it was loaded from."""

    named: str
    commit: str | None
    """The commit on the Hub; None for a folder or a file."""
    files: dict[str, str]
    """Name -> SHA-256."""
    folder: Path
    """A folder with a copy of these files, and nothing else."""
    policy: Any
    """A policy that `evaluate` accepts; its attributes name its observation."""
    library: str
    """The library that runs it."""


@contextmanager
def fetched(
    named: str, folder: Path | None = None, pinned: Mapping[str, Any] | None = None
) -> Iterator[Submission]:
    """Load a submission, and yield it; its copied files are removed at the end.

    Args:
        named: An id on the Hub, a folder or a file; optionally followed by `@` and a revision or,
            for a folder or a file, the SHA-256 of its weights.
        folder: The folder of its files, if they are not at `named`.
        pinned: The `commit` and `files` that were judged; None if it is judged for the first time.

    Raises:
        DatasetError: The policy does not exist, or differs from the named or pinned revision.
        PolicyError: An ONNX graph has other inputs or outputs than a policy.
    """
    try:
        if folder is not None:
            source = files_of(folder)
        elif pinned:
            source = files_of(named.partition("@")[0], pinned["commit"], on_hub=True)
        else:
            source = files_of(named)
    except PolicyNameError as error:
        raise DatasetError(str(error)) from error
    with private_folder() as own:
        copies = source.copied(own)
        files = dict(sorted(copies.origin().files.items()))
        for name, expected in pinned["files"].items() if pinned else ():
            if files.get(name) != expected:
                raise DatasetError(
                    f"{named}: {name} differs from the named revision: it is "
                    f"{files.get(name) or 'missing':.16}, not {expected:.16}"
                )
        try:
            policy = copies.open(named)
        except DatasetError as error:  # Name the original, not the temporary copy.
            raise DatasetError(str(error).replace(str(own), named)) from error
        if source.is_graph:
            with policy:
                yield Submission(named, source.commit, files, own, policy, "onnxruntime")
        else:
            import torch

            torch.set_num_threads(1)  # With several threads, sums may round differently.
            yield Submission(named, source.commit, files, own, _Limited(policy), "torch")


class _Limited:
    """A loaded policy that is refused if a call takes too long, as a graph is.

    It has `SECONDS` for a batch, or for each labyrinth if it plans for one at a time.
    """

    def __init__(self, policy: Any) -> None:
        self._policy, self._late = policy, Event()
        for module in policy.network.modules():  # So that a long call ends before its end.
            module.register_forward_pre_hook(lambda *_: self._require_time())

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the policy: what it has to be shown, or a method."""
        attribute = getattr(self._policy, name)
        if name != "act":
            return attribute
        return lambda observations: self._in_time(attribute, observations, len(observations))

    def for_labyrinths(self, height: int, width: int, task: Task) -> _Limited:
        """Return the policy for labyrinths of another size."""
        return _Limited(self._policy.for_labyrinths(height, width, task))

    def __call__(self, observations: NDArray[Any]) -> Any:
        """Return the scores of the four actions, shape (B, 4)."""
        return self._in_time(self._policy, observations)

    def _in_time(
        self, call: Callable[[NDArray[Any]], Any], observations: NDArray[Any], parts: int = 1
    ) -> Any:
        self._late = Event()
        timer = Timer(SECONDS * parts, self._late.set)
        timer.start()
        try:
            answer = call(observations)
        finally:
            timer.cancel()
        self._require_time()
        return answer

    def _require_time(self) -> None:
        if self._late.is_set():
            raise PolicyError(f"the policy takes more than {SECONDS:g} seconds")


def versions(library: str) -> dict[str, str]:
    """Return the versions of the libraries that judge a policy."""
    return {name: version(name) for name in ("labyrinth-datasets", "numpy", library)}
