"""`load_policy` loads a policy for `evaluate` from a folder or the Hub.

It reads two files of data: `config.json`, in which every value is checked, and weights in the
safetensors format, which holds no code; in the folder of a run also its record. Nothing else is
downloaded, and no code is executed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.language.source_text import printable_line
from labyrinth_core.learning.spec import CONFIG, GRAPH, RECORD, WEIGHTS, PolicySpec
from labyrinth_core.policies.record import SUMS, listed, read_run, trained_run
from labyrinth_core.policies.weights import read_tensors
from labyrinth_core.storage import File

if TYPE_CHECKING:
    import torch

    from labyrinth_core.learning.networks.acting import LoadedMapper, LoadedPolicy

PUBLISHED = {CONFIG: 1 << 16, WEIGHTS: 1 << 28}
MOST_BYTES: Mapping[str, int] = {
    **PUBLISHED,
    RECORD: 1 << 26,
    GRAPH: 1 << 28,
    SUMS: 1 << 20,
}
"""The size limit of each file, in bytes; the weights of the largest network here take 46 MB."""

_UNREADABLE = (OSError, ValueError, RecursionError)
"""Exceptions for a file that cannot be read or has invalid content."""


def load_policy(source: str | Path, *, revision: str | None = None) -> LoadedPolicy | LoadedMapper:
    """Return a published or trained policy, ready for `evaluate`.

    It is a function from B observations to the scores of the four actions, shape (B, 4). A mapper
    remembers its plan, so it is an object with `reset(count)` and `act(observations)`, which
    returns B actions. Both have the PyTorch module as `network`, on the CPU; `spec`, which tells
    `evaluate` what to show them; `predict` as in Stable-Baselines3; and
    `for_labyrinths(height, width, task)`, which returns the policy for labyrinths of another size
    than in training.

    Args:
        source: The folder of a run, such as `runs/5x5/bc-cnn-seed0`; a folder with `config.json`
            and `model.safetensors`; or an id on the Hub such as `user/planner-5x5`.
        revision: Branch, tag or commit on the Hub; not for folders.

    Raises:
        ValueError: A revision is given for a folder.
        DatasetError: The policy does not exist, one of its files is too large or has invalid
            content, or PyTorch is not installed.
    """
    try:
        import safetensors.torch  # noqa: F401
    except ModuleNotFoundError as error:
        raise DatasetError(
            f"{source}: a policy needs torch: pip install 'labyrinth-datasets[train]'"
        ) from error
    folder = located(source, revision)
    record = read_run(folder)  # It compares the files with their hashes in the record.
    policy = _with_weights(_read_spec(folder / CONFIG), folder / WEIGHTS)
    if record is not None and ":" not in record["run"]["method"]:
        policy.run = trained_run(record)
    return policy


def located(source: str | Path, revision: str | None) -> Path:
    """Return the folder with the files of a policy; for an id, download them first.

    The arguments and errors are those of `load_policy`.
    """
    folder = Path(source).expanduser()
    if not folder.is_dir():
        from labyrinth_core import hub

        if not hub.ID.fullmatch(str(source)):
            raise DatasetError(f"{source} is neither a folder nor an id such as user/planner-5x5")
        return downloaded(str(source), revision, PUBLISHED)
    if revision is not None:
        raise ValueError(f"revision={revision}: {source} is a folder, which has no revisions")
    _require_listed(folder, PUBLISHED)
    return folder


def downloaded(repo_id: str, revision: str | None, names: Iterable[str]) -> Path:
    """Download those files of a policy that exist, and return the folder of their commit.

    Args:
        repo_id: The model on the Hub.
        revision: As for `load_policy`.
        names: The names of the files, from the keys of `MOST_BYTES`.

    Raises:
        DatasetError: A file is too large or damaged, or the Hub does not give it.
    """
    from labyrinth_core import hub

    names = [*names]
    folder = hub.fetched(repo_id, revision, {name: MOST_BYTES[name] for name in (*names, SUMS)})
    _require_listed(folder, names)
    return folder


def _require_listed(folder: Path, names: Iterable[str]) -> None:
    """Raise DatasetError if a file of a policy has another hash than in the folder's list."""
    for name in names:
        path, hashes = folder / name, listed(folder / SUMS, name)
        if hashes and path.exists() and File(path).sha256() not in hashes:
            told = f"{path} is damaged: its sha256 is not the one in {SUMS}"
            raise DatasetError(f"{told}; download or train it again")


def check_size(place: object, name: str, size: int) -> None:
    """Raise DatasetError if a file of a policy, such as `config.json`, is too large."""
    if size > MOST_BYTES[name]:
        raise DatasetError(f"{place} has {size:,} bytes, more than {MOST_BYTES[name]:,}")


def _read_spec(path: Path) -> PolicySpec:
    try:
        check_size(path, CONFIG, path.stat().st_size)
        return PolicySpec.from_json(File(path).read_json())
    except FileNotFoundError as error:
        reason = f"the folder holds neither a published policy nor a run ({RECORD})"
        raise DatasetError(f"{path} does not exist: {reason}") from error
    except _UNREADABLE as error:
        raise DatasetError(f"{path} describes no policy: {one_line(error):.300}") from error


def _read_weights(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """Return the tensors and the texts in a file of weights."""
    try:
        check_size(path, path.name, path.stat().st_size)
        return read_tensors(path)
    except FileNotFoundError as error:
        raise DatasetError(f"{path} does not exist: the folder holds no policy") from error
    except _UNREADABLE as error:
        raise DatasetError(f"{path} holds no weights: {one_line(error):.300}") from error


def _with_weights(spec: PolicySpec, path: Path) -> LoadedPolicy | LoadedMapper:
    """Return the policy with its weights, after checking their names, shapes and dtypes."""
    import torch

    from labyrinth_core.learning.networks.acting import LoadedMapper, LoadedPolicy, make_network
    from labyrinth_core.learning.networks.mapping import Mapper
    from labyrinth_core.learning.networks.network import usual_defaults

    def make() -> torch.nn.Module:
        return make_network(spec.network, average=spec.average, own=spec.own)

    # On this device no memory is allocated: a file could ask for any amount.
    with usual_defaults(), torch.device("meta"):
        expected = {name: (each.shape, each.dtype) for name, each in make().state_dict().items()}
    tensors, _ = _read_weights(path)
    for name in sorted(expected.keys() | tensors.keys()):
        tensor = tensors.get(name)
        found = None if tensor is None else (tensor.shape, tensor.dtype)
        if found != expected.get(name):
            is_, should_be = map(_described, (found, expected.get(name)))
            told = f"{printable_line(name):.200} is {is_}, not {should_be}"
            raise DatasetError(f"{path} is of another network: {told}")
    with usual_defaults():
        network = make()
    network.load_state_dict(tensors)
    network.eval()
    if isinstance(network, Mapper):
        return LoadedMapper(network, spec)
    return LoadedPolicy(network, spec)


def _described(tensor: Any) -> str:
    if tensor is None:
        return "absent"
    shape, dtype = tensor
    return f"{str(dtype).removeprefix('torch.')} of shape {tuple(shape)}"
