"""The record of a finished run: `run.json`, written last, and the plot of its learning curves."""

from __future__ import annotations

import io
import json
import platform
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from labyrinth_core.data.errors import MALFORMED, DatasetError
from labyrinth_core.data.schema import read_json
from labyrinth_core.data.storage import file_sha256, write_bytes, write_text
from labyrinth_core.evaluation.results import RESULTS
from labyrinth_core.policies.spec import POLICY, RECORD
from labyrinth_core.version import __version__
from pipeline.config.errors import ConfigError
from pipeline.training.checkpoint import Progress
from pipeline.training.policy import load_tensors

CHECKPOINT = "checkpoint.safetensors"
CURVES = "curves.png"
BOARD = "tensorboard"
FORMAT = 1


def current_versions() -> dict[str, str]:
    """Return the versions of this package, of Python and of the libraries that affect weights."""
    libraries = {name: version(name) for name in ("numpy", "safetensors", "torch")}
    return {"labyrinth-datasets": __version__, "python": platform.python_version()} | libraries


def write_record(
    folder: Path, identity: Mapping[str, Any], progress: Progress, computed: Mapping[str, Any]
) -> None:
    """Write `run.json` into a run's folder, atomically, with the hashes of the files beside it.

    `identity` determines the run (method, settings, encoder, seed, dataset, ...); `computed` tells
    the device and the number of threads.
    """
    content = {
        "format": FORMAT,
        "run": identity,
        "computed": {**computed, "versions": current_versions()},
        "seconds": round(progress.seconds, 3),
        "epochs": progress.epoch,
        "selected": progress.best,
        "history": progress.history,
        "files": {name: file_sha256(folder / name) for name in (POLICY, CURVES)},
    }
    write_text(folder / RECORD, json.dumps(content, indent=1) + "\n")


def read_record(folder: Path) -> dict[str, Any] | None:
    """Return the content of `run.json`, or None if the folder holds no finished run.

    Raises:
        DatasetError: The file cannot be read.
    """
    path = folder / RECORD
    try:
        content = read_json(path)
        if content["format"] != FORMAT:
            raise ValueError(f"its format is {content['format']}, not {FORMAT}")
        if not all(isinstance(content[name], dict) for name in ("run", "files")):
            raise ValueError("its run or its files are not an object")
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise DatasetError(f"{path} cannot be read: {error!r:.300}") from error
    return dict(content)


def files_to_replace(folder: Path, *, overwrite: bool) -> list[Path]:
    """Return the files of an earlier run that are to be removed before another one.

    These are the files of a finished run, the results of its policy and the checkpoint of an
    interrupted run; none without `overwrite`.

    Raises:
        DatasetError: A file with the name of one is not of this run, as far as `run.json` knows.
    """
    checkpoint = folder / CHECKPOINT
    interrupted = [checkpoint] if checkpoint.exists() else []
    if interrupted and not overwrite:
        return []
    for path in interrupted:
        load_tensors(path, "state")  # Raises if it is something else.
    recorded = (read_record(folder) or {"files": {}})["files"]
    found = [folder / name for name in (RECORD, POLICY, CURVES) if (folder / name).exists()]
    others = [p for p in found if p.name != RECORD and file_sha256(p) != recorded.get(p.name)]
    for path in sorted(folder.glob(f"{Path(RESULTS).stem}*.json")):
        found.append(path)
        with suppress(*MALFORMED):
            if read_json(path)["run"]["evaluated"]["weights"] == recorded[POLICY]:
                continue
        others.append(path)
    if others:
        raise DatasetError(f"{others[0]} is not of the run in its folder: move it away")
    return [*found, *interrupted] if overwrite else []


def open_board(folder: Path) -> Any:
    """Return a writer of figures for TensorBoard into `tensorboard/`, without earlier events.

    Raises:
        ConfigError: TensorBoard is not installed.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        needed = "pip install 'labyrinth-datasets[tensorboard]'"
        raise ConfigError(f"tensorboard=true needs TensorBoard: {needed}") from error
    for path in (folder / BOARD).glob("events.out.tfevents.*"):
        path.unlink()
    return SummaryWriter(str(folder / BOARD))


def draw_curves(folder: Path, title: str, history: Sequence[Mapping[str, float]]) -> None:
    """Plot losses and success rates by epoch into `curves.png`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name in sorted({name for row in history for name in row} - {"epoch", "seconds"}):
        axes = right if name.endswith("_sr") else left
        rows = [row for row in history if name in row]
        axes.plot([row["epoch"] for row in rows], [row[name] for row in rows], label=name)
    right.set(xlabel="epoch", title="success rate", ylim=(-0.02, 1.02))
    left.set(xlabel="epoch", title=title)
    for axes in (left, right):
        axes.legend(frameon=False)
        axes.spines[["top", "right"]].set_visible(False)
    png = io.BytesIO()
    figure.savefig(png, format="png", dpi=120, metadata={"Software": None})
    write_bytes(folder / CURVES, png.getvalue())
