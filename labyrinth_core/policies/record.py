"""The record of a finished run, `run.json`: what determines the run, its history and its files."""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypedDict

from labyrinth_core.data import typed
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.storage import File
from labyrinth_core.evaluation.description import TrainedRun, Training
from labyrinth_core.learning import PolicySpec
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
    config: typed.ConfigName
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
            "format": FORMAT,
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
