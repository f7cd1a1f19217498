"""The files of a policy in a folder or on the Hub: `load_policy`, and the record of its run.

A policy has two files of data: `config.json`, in which every value is checked, and weights in the
safetensors format, which holds no code. The folder of a run also has its record, `run.json`.
Nothing else is downloaded, and no code is executed.
"""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypedDict

from labyrinth_core import typed
from labyrinth_core.data import DatasetConfig
from labyrinth_core.errors import MALFORMED, DatasetError, one_line
from labyrinth_core.evaluation import PolicyError, TrainedRun, Training
from labyrinth_core.learning import PolicySpec
from labyrinth_core.storage import File
from labyrinth_core.version import __version__

if TYPE_CHECKING:
    from torch import Tensor

    from labyrinth_core.learning import TrainedPolicy

RECORD_FORMAT = 2
SUMS = "SHA256SUMS"
"""The list of the hashes of a folder's files, in the format of `sha256sum`."""


class MadeBy(TypedDict):
    """What determines the weights of a run; a method in Python has its `code`, too."""

    method: Annotated[str, typed.Like(r"\w[\w.:-]*")]
    encoder: typed.Word
    observation: Literal["image", "vector"]
    protocol: typed.Word
    train_labyrinths: typed.Learnt
    seed: typed.Seed
    settings: Mapping[typed.Word, Any]
    config: Annotated[str, typed.Like(DatasetConfig.NAME.pattern)]
    dataset: str
    revision: str | None
    fingerprint: typed.Sha256


class Content(Training):
    """The content of `run.json`."""

    format: Literal[2]
    run: MadeBy
    history: list[Mapping[str, Any]]
    """The metrics of each epoch."""
    files: Mapping[typed.Word, typed.Sha256]
    """Name -> SHA-256 of the other files, among them the weights."""


@dataclass(frozen=True)
class RunRecord:
    """The record of a finished run."""

    FILE: ClassVar[str] = "run.json"

    content: Content

    @classmethod
    def read(cls, folder: Path) -> RunRecord | None:
        """Return the record in a folder, or None if the folder holds no finished run.

        The file is compared with its hash in the folder's `SHA256SUMS`, if that lists it, and the
        policy's files with theirs in the record.

        Raises:
            DatasetError: One of these files is damaged, or `run.json` has another form.
        """
        path = folder / cls.FILE
        again = "stages=train overwrite=true makes it again"
        try:
            expected = listed(folder / SUMS, cls.FILE)
            if expected and File(path).sha256() not in expected:
                told = f"{path} is damaged: its sha256 is not the one in SHA256SUMS"
                raise DatasetError(f"{told}; {again}")
            content: Content = typed.read_as(Content, File(path).read_json())
            rows, selected = content["history"], content["selected"]
            if len(rows) != content["epochs"] or selected not in rows:
                told = f"{len(rows)} in its history, of which epoch {selected['epoch']} is selected"
                raise ValueError(f"it has {content['epochs']} epochs, but {told}")
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError, RecursionError) as error:
            raise DatasetError(f"{path} cannot be read: {one_line(error):.300}; {again}") from error
        for name in (PolicySpec.WEIGHTS, PolicySpec.FILE):
            if name in content["files"] or name == PolicySpec.WEIGHTS:
                try:
                    actual = File(folder / name).sha256()
                except FileNotFoundError as error:
                    told = f"{folder / name} does not exist: stages=train makes it"
                    raise DatasetError(told) from error
                if actual != content["files"].get(name):
                    told = f"{folder / name} is damaged: its sha256 is not the one in {cls.FILE}"
                    raise DatasetError(f"{told}; {again}")
        return cls(content)

    @staticmethod
    def write(
        folder: Path,
        run: Mapping[str, Any],
        history: Sequence[Mapping[str, Any]],
        selected: Mapping[str, Any] | None,
        seconds: float,
        computed: Mapping[str, Any],
        files: Sequence[str],
    ) -> None:
        """Write the record of a run into its folder.

        Args:
            folder: The folder, with the other files.
            run: What determines the weights: method, settings, seed, dataset, ...
            history: The metrics of each epoch.
            selected: Those of the epoch whose policy was kept.
            seconds: The training time.
            computed: The device and the number of threads.
            files: The names of the other files.
        """
        content = {
            "format": RECORD_FORMAT,
            "run": run,
            "computed": {**computed, "versions": training_versions()},
            "seconds": round(seconds, 3),
            "epochs": len(history),
            "selected": selected,
            "history": history,
            "files": {name: File(folder / name).sha256() for name in files},
        }
        File(folder / RunRecord.FILE).write_text(json.dumps(content, indent=1) + "\n")

    def trained_run(self, device: str = "cpu") -> TrainedRun:
        """Return the run as results describe it; its policy runs on `device`."""
        made = self.content["run"]
        shared = {each.name for each in fields(TrainedRun)} & made.keys() - {"method"}
        return TrainedRun(
            method=TrainedRun.title_of(made["method"]),
            **{name: made[name] for name in shared},  # type: ignore[literal-required]
            training={
                "epochs": self.content["epochs"],
                "seconds": self.content["seconds"],
                "selected": self.content["selected"],
                "computed": self.content["computed"],
            },
            evaluated={
                "device": device,
                "versions": training_versions(),
                "weights": self.content["files"][PolicySpec.WEIGHTS],
            },
        )


def training_versions() -> dict[str, str]:
    """Return the versions of this package, of Python, and of the libraries that affect weights."""
    libraries = {name: version(name) for name in ("numpy", "safetensors", "torch")}
    return {"labyrinth-datasets": __version__, "python": platform.python_version()} | libraries


def listed(sums: Path, name: str) -> list[str]:
    """Return the hashes of a file in a list of hashes, which need not exist."""
    try:
        text = sums.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return []
    return re.findall(rf"^([0-9a-f]{{64}})  {re.escape(name)}$", text, re.MULTILINE)


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
