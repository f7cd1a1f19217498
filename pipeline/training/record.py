"""What a finished run says of itself: `run.json`, written last, and the picture of its curves."""

from __future__ import annotations

import json
import platform
import shutil
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from labyrinth_core import __version__
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.storage import write_text
from pipeline.config.errors import ConfigError
from pipeline.training.checkpoint import Progress

RECORD = "run.json"
POLICY = "policy.safetensors"
CHECKPOINT = "checkpoint.safetensors"
CURVES = "curves.png"
BOARD = "tensorboard"
FORMAT = 1


def current_versions() -> dict[str, str]:
    """Return the versions of what shapes weights in this process."""
    libraries = {name: version(name) for name in ("numpy", "safetensors", "torch")}
    return {"labyrinth-datasets": __version__, "python": platform.python_version()} | libraries


def write_record(
    folder: Path,
    identity: Mapping[str, Any],
    progress: Progress,
    computed: Mapping[str, Any],
) -> None:
    """Write `run.json` into a run's folder, all or nothing.

    Args:
        folder: Of the run.
        identity: What the run is: method, settings, encoder, seed, dataset, ...
        progress: The whole history.
        computed: Where it was computed: device and threads.
    """
    content = {
        "format": FORMAT,
        "run": identity,
        "computed": {**computed, "versions": current_versions()},
        "seconds": round(progress.seconds, 3),
        "epochs": progress.epoch,
        "selected": progress.best,
        "history": progress.history,
    }
    write_text(folder / RECORD, json.dumps(content, indent=1) + "\n")


def read_record(folder: Path) -> dict[str, Any] | None:
    """Return `run.json` of a folder, None if no run is finished there.

    Raises:
        DatasetError: It cannot be read.
    """
    path = folder / RECORD
    try:
        content = json.loads(path.read_bytes())
        if content["format"] != FORMAT or not isinstance(content["run"], dict):
            raise ValueError(f"its format is {content['format']}, not {FORMAT}")
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise DatasetError(f"{path} cannot be read: {error!r:.300}") from error
    return dict(content)


class Board:
    """The figures of a run for TensorBoard, in `tensorboard/` of its folder, epoch by epoch.

    Raises:
        ConfigError: TensorBoard is not installed.
    """

    def __init__(self, folder: Path) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            needed = "pip install 'labyrinth-datasets[tensorboard]'"
            raise ConfigError(f"tensorboard=true needs TensorBoard: {needed}") from error
        shutil.rmtree(folder / BOARD, ignore_errors=True)
        self._writer: Any = SummaryWriter(str(folder / BOARD))
        self._written = 0

    def write(self, history: Sequence[Mapping[str, float]]) -> None:
        """Write the epochs that were not written yet, also those before an interruption."""
        for row in history[self._written :]:
            for name, value in row.items():
                if name != "epoch":
                    self._writer.add_scalar(name, value, row["epoch"])
        self._written = len(history)
        self._writer.flush()


def draw_curves(folder: Path, title: str, history: Sequence[Mapping[str, float]]) -> None:
    """Draw losses and success rates by epoch into `curves.png`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    names = sorted({name for row in history for name in row} - {"epoch", "seconds"})
    for name in names:
        axes = right if name.endswith("_sr") else left
        rows = [row for row in history if name in row]
        axes.plot([row["epoch"] for row in rows], [row[name] for row in rows], label=name)
    right.set(xlabel="epoch", title="success rate", ylim=(-0.02, 1.02))
    left.set(xlabel="epoch", title=title)
    for axes in (left, right):
        axes.legend(frameon=False)
        axes.spines[["top", "right"]].set_visible(False)
    temporary = folder / f".{CURVES}.tmp"
    figure.savefig(temporary, format="png", dpi=120, metadata={"Software": None})
    temporary.replace(folder / CURVES)
