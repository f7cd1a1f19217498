"""A submission: a policy and its files, pinned by a commit on the Hub or by their SHA-256."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from importlib.metadata import version
from pathlib import Path
from threading import Event, Timer
from typing import Any, NamedTuple

from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.location import HUB_ID
from labyrinth_core.data.storage import file_sha256
from labyrinth_core.evaluation.answers import PolicyError
from labyrinth_core.policies.load import MOST_BYTES, check_size, load_policy, located
from labyrinth_core.policies.spec import CONFIG, GRAPH, POLICY, RECORD, WEIGHTS
from labyrinth_core.world.labyrinth import Task
from pipeline.season.files import private_folder, require_regular
from pipeline.season.graph import SECONDS, computed

_KINDS = ((WEIGHTS, CONFIG), (POLICY, RECORD), (GRAPH,))
"""The files of each kind of policy, the weights first."""


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
    source, _, revision = named.partition("@")
    with private_folder() as own, ExitStack() as stack:
        commit = None
        if folder is None and (pinned or not Path(source).expanduser().exists()):
            commit, names = _on_hub(source, pinned["commit"] if pinned else revision or None)
            try:
                found = located(source, commit, names)
            except ValueError as error:
                raise DatasetError(str(error)) from error
            _copy({name: found / name for name in names}, own)
        else:
            _copy(_in_folder(Path(source).expanduser() if folder is None else folder), own)
        files = {path.name: file_sha256(path) for path in sorted(own.iterdir())}
        for name, expected in pinned["files"].items() if pinned else ():
            _require(named, name, files.get(name), expected)
        if commit is None and revision:
            weights = next(names[0] for names in _KINDS if names[0] in files)
            _require(named, weights, files[weights], revision)
        if GRAPH in files:
            policy = stack.enter_context(computed((own / GRAPH).read_bytes(), named))
            yield Submission(named, commit, files, own, policy, "onnxruntime")
        else:
            yield Submission(named, commit, files, own, _loaded(own, named), "torch")


def _loaded(folder: Path, named: str) -> Any:
    """Load the policy of a folder with weights."""
    try:
        policy = load_policy(folder)
    except DatasetError as error:  # Name the original, not the temporary copy.
        raise DatasetError(str(error).replace(str(folder), named)) from error
    import torch

    torch.set_num_threads(1)  # With several threads, sums may round differently.
    return _Limited(policy)


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
        found = getattr(self._policy, name)
        if name != "act":
            return found
        return lambda observations: self._in_time(found, observations, len(observations))

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


def _on_hub(source: str, revision: str | None) -> tuple[str, tuple[str, ...]]:
    """Return the commit of a revision on the Hub, and the names of its policy's files."""
    if not HUB_ID.fullmatch(source):
        raise DatasetError(f"{source} is neither a folder, a file, nor an id such as user/model")
    from huggingface_hub import HfApi

    from labyrinth_core.data import hub

    hub.prepare_client()
    try:
        found = HfApi().model_info(source, revision=revision)
    except hub.UNAVAILABLE as error:
        reason = f"{source} is not a folder, and cannot be loaded from the Hub"
        raise DatasetError(f"{reason}: {one_line(error):.300}") from error
    return str(found.sha), _kind(source, {each.rfilename for each in found.siblings or ()})


def _in_folder(place: Path) -> dict[str, Path]:
    """Return the files of a policy by name: those in a folder, or a single ONNX graph."""
    if place.is_dir():
        held = {path.name for path in place.iterdir()}
        return {name: place / name for name in _kind(str(place), held)}
    if place.suffix != ".onnx":
        raise DatasetError(f"{place} is neither a folder nor an ONNX graph, such as {GRAPH}")
    return {GRAPH: place}


def _kind(place: str, held: set[str]) -> tuple[str, ...]:
    for names in _KINDS:
        if held >= set(names):
            return names
    kinds = "; ".join(" and ".join(names) for names in _KINDS)
    raise DatasetError(f"{place} holds no policy: give {kinds}")


def _copy(files: Mapping[str, Path], folder: Path) -> None:
    """Copy files, so that the hashed bytes are the judged ones; refuse files that are too large."""
    for name, path in files.items():
        try:
            require_regular(path, MOST_BYTES[name])
            with path.open("rb") as file:
                content = file.read(MOST_BYTES[name] + 1)
            check_size(path, name, len(content))  # It may have grown since.
            (folder / name).write_bytes(content)
        except OSError as error:
            raise DatasetError(f"{path} cannot be read: {one_line(error)}") from error


def _require(named: str, what: str, found: str | None, expected: str) -> None:
    if found != expected:
        raise DatasetError(
            f"{named}: {what} differs from the named revision: it is "
            f"{found or 'missing':.16}, not {expected:.16}"
        )


def versions(library: str) -> dict[str, str]:
    """Return the versions of the libraries that judge a policy."""
    return {name: version(name) for name in ("labyrinth-datasets", "numpy", library)}
