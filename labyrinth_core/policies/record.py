"""`read_run` reads the record of a finished run, `run.json`, for everything that opens a run."""

from __future__ import annotations

import platform
import re
from collections.abc import Mapping
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

from labyrinth_core import typed
from labyrinth_core.data import DatasetConfig
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.evaluation import TrainedRun, Training
from labyrinth_core.learning.spec import CONFIG, RECORD, WEIGHTS
from labyrinth_core.storage import File
from labyrinth_core.version import __version__

FORMAT = 2
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


class Record(Training):
    """The content of `run.json`."""

    format: Literal[2]
    run: MadeBy
    history: list[Mapping[str, Any]]
    """The metrics of each epoch."""
    files: Mapping[typed.Word, typed.Sha256]
    """Name -> SHA-256 of the other files, among them the weights."""


def read_run(folder: Path) -> Record | None:
    """Return the content of `run.json`, or None if the folder holds no finished run.

    The file is compared with its hash in the folder's `SHA256SUMS`, if that lists it, and the
    policy's files with theirs in `run.json`.

    Raises:
        DatasetError: One of these files is damaged, or `run.json` has another form.
    """
    path = folder / RECORD
    again = "stages=train overwrite=true makes it again"
    try:
        expected = listed(folder / SUMS, RECORD)
        if expected and File(path).sha256() not in expected:
            told = f"{path} is damaged: its sha256 is not the one in SHA256SUMS"
            raise DatasetError(f"{told}; {again}")
        content: Record = typed.read_as(Record, File(path).read_json())
        rows, selected = content["history"], content["selected"]
        if len(rows) != content["epochs"] or selected not in rows:
            told = f"{len(rows)} in its history, of which epoch {selected['epoch']} is selected"
            raise ValueError(f"it has {content['epochs']} epochs, but {told}")
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{path} cannot be read: {one_line(error):.300}; {again}") from error
    for name in (WEIGHTS, CONFIG):
        if name in content["files"] or name == WEIGHTS:
            try:
                found = File(folder / name).sha256()
            except FileNotFoundError as error:
                told = f"{folder / name} does not exist: stages=train makes it"
                raise DatasetError(told) from error
            if found != content["files"].get(name):
                told = f"{folder / name} is damaged: its sha256 is not the one in {RECORD}"
                raise DatasetError(f"{told}; {again}")
    return content


def trained_run(record: Mapping[str, Any], device: str = "cpu") -> TrainedRun:
    """Return a training run as results describe it; its policy runs on `device`."""
    made = record["run"]
    shared = {each.name for each in fields(TrainedRun)} & made.keys() - {"method"}
    return TrainedRun(
        method=TrainedRun.title_of(made["method"]),
        **{name: made[name] for name in shared},
        training={
            "epochs": record["epochs"],
            "seconds": record["seconds"],
            "selected": record["selected"],
            "computed": record["computed"],
        },
        evaluated={
            "device": device,
            "versions": training_versions(),
            "weights": record["files"][WEIGHTS],
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
