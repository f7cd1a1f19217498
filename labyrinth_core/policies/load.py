"""`load_policy` loads a policy for `evaluate` from a folder or the Hub.

It reads two files of data: `config.json`, in which every value is checked, and weights in the
safetensors format, which holds no code; in the folder of a run also its record. Nothing else is
downloaded, and no code is executed.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from labyrinth_core.data.errors import MALFORMED, DatasetError, one_line
from labyrinth_core.data.location import HUB_ID
from labyrinth_core.data.storage import File
from labyrinth_core.evaluation.answers import PolicyError
from labyrinth_core.learning import PolicySpec
from labyrinth_core.policies.record import SUMS, RunRecord, listed

if TYPE_CHECKING:
    from torch import Tensor

    from labyrinth_core.learning import TrainedPolicy

GRAPH = "model.onnx"
"""The only file of an ONNX policy, which `load_policy` does not read."""

PUBLISHED = {PolicySpec.FILE: 1 << 16, PolicySpec.WEIGHTS: 1 << 28}
MOST_BYTES: Mapping[str, int] = {
    **PUBLISHED,
    RunRecord.FILE: 1 << 26,
    GRAPH: 1 << 28,
    SUMS: 1 << 20,
}
"""The size limit of each file, in bytes; the weights of the largest network here take 46 MB."""

_UNREADABLE = (OSError, ValueError, RecursionError)
"""Exceptions for a file that cannot be read or has invalid content."""


def load_policy(source: str | Path, *, revision: str | None = None) -> TrainedPolicy:
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
    from labyrinth_core.learning import TrainedPolicy

    folder = located(source, revision)
    record = RunRecord.read(folder)  # It compares the files with their hashes in the record.
    spec, weights = _read_spec(folder), _read_weights(folder / PolicySpec.WEIGHTS)
    try:
        policy = TrainedPolicy.of(spec, weights)
    except PolicyError as error:
        raise DatasetError(
            f"{folder / PolicySpec.WEIGHTS} is of another network: {error}"
        ) from error
    if record is not None and ":" not in record.content["run"]["method"]:
        policy.run = record.trained_run()
    return policy


def located(source: str | Path, revision: str | None) -> Path:
    """Return the folder with the files of a policy; for an id, download them first.

    The arguments and errors are those of `load_policy`.
    """
    folder = Path(source).expanduser()
    if not folder.is_dir():
        if not HUB_ID.fullmatch(str(source)):
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
    from labyrinth_core.data import hub

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


def check_size(path: object, name: str, size: int) -> None:
    """Raise DatasetError if a file of a policy, such as `config.json`, is too large."""
    if size > MOST_BYTES[name]:
        raise DatasetError(f"{path} has {size:,} bytes, more than {MOST_BYTES[name]:,}")


def _read_spec(folder: Path) -> PolicySpec:
    path = folder / PolicySpec.FILE
    try:
        check_size(path, path.name, path.stat().st_size)
        return PolicySpec.from_json(File(path).read_json())
    except FileNotFoundError as error:
        reason = f"the folder holds neither a published policy nor a run ({RunRecord.FILE})"
        raise DatasetError(f"{path} does not exist: {reason}") from error
    except _UNREADABLE as error:
        raise DatasetError(f"{path} describes no policy: {one_line(error):.300}") from error


def _read_weights(path: Path) -> dict[str, Tensor]:
    try:
        check_size(path, path.name, path.stat().st_size)
        return read_tensors(path)[0]
    except FileNotFoundError as error:
        raise DatasetError(f"{path} does not exist: the folder holds no policy") from error
    except _UNREADABLE as error:
        raise DatasetError(f"{path} holds no weights: {one_line(error):.300}") from error


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Return the tensors in a file, on the CPU, and the texts in its header.

    The file is read, not mapped into memory, which some network file systems do not support.

    Raises:
        OSError: The file does not exist, or cannot be read.
        ValueError: The file has another format.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    content = path.read_bytes()
    try:
        tensors = load(content)
        header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
    except (SafetensorError, RuntimeError, *MALFORMED) as error:
        raise ValueError(one_line(error)) from error
    return tensors, header.get("__metadata__") or {}
