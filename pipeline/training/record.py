"""The record of a finished run: `run.json`, with hashes of the other files, and learning curves."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from labyrinth_core.errors import one_line
from labyrinth_core.evaluation import Results
from labyrinth_core.learning import PolicySpec
from labyrinth_core.policies import RunRecord
from labyrinth_core.storage import File
from pipeline.config import ConfigError, Job
from pipeline.machinery import Sums, leave, say
from pipeline.training.checkpoint import Progress

CHECKPOINT = "checkpoint.safetensors"
CURVES = "curves.png"
BOARD = "tensorboard"

OURS = (
    RunRecord.FILE,
    PolicySpec.WEIGHTS,
    PolicySpec.FILE,
    CURVES,
    Job.CONFIG,
    f"{Path(Results.FILE).stem}*.json",
)
"""File name patterns in the folder of a run that belong to us; the user may keep other files."""


def write_record(
    folder: Path,
    name: str,
    identity: Mapping[str, Any],
    progress: Progress,
    computed: Mapping[str, Any],
) -> None:
    """Write `run.json` and `curves.png` into the folder that holds the policy of a run.

    If the curves cannot be drawn, they are left out, and one line says why.

    Args:
        folder: The folder of the run.
        name: The name of the run, for the title of the curves.
        identity: Everything that determines the run's weights: method, settings, seed, dataset, ...
        progress: The progress of the finished run.
        computed: The device and the number of threads.
    """
    try:
        picture = _curves(name, progress.history)
    except Exception as error:  # Any error: a plot must never cost the policy.
        say(f"{CURVES} is left out, because it cannot be drawn: {one_line(error):.300}")
    else:
        File(folder / CURVES).write_bytes(picture)
    names = (PolicySpec.WEIGHTS, PolicySpec.FILE, CURVES)
    RunRecord.write(
        folder,
        identity,
        progress.history,
        progress.best,
        progress.seconds,
        computed,
        files=[name for name in names if (folder / name).exists()],
    )


def restore_curves(folder: Path, name: str) -> None:
    """Draw the curves of a finished run again if they are missing; say so if they were changed.

    Raises:
        DatasetError: The record cannot be read.
        OSError: The picture cannot be written.
    """
    record = RunRecord.read(folder)
    if record is None or CURVES not in record.content["files"] or Sums.read(folder).has(CURVES):
        return
    if (folder / CURVES).exists():
        say(f"{folder / CURVES} was damaged or changed: delete it to have it drawn again.")
    else:
        leave(folder, {CURVES: _curves(name, record.content["history"])})
        say(f"{folder / CURVES} was missing, and is drawn again.")


@contextmanager
def open_board(folder: Path) -> Iterator[Any]:
    """Yield a TensorBoard `SummaryWriter` for the folder `tensorboard/` of a run.

    TensorBoard puts the computer's name into those of its files; it is removed at the end.

    Raises:
        ConfigError: TensorBoard is not installed.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        needed = "pip install 'labyrinth-datasets[tensorboard]'"
        raise ConfigError(f"tensorboard=true needs TensorBoard: {needed}") from error
    with SummaryWriter(str(folder / BOARD)) as board:
        yield board
    for path in (folder / BOARD).iterdir():
        path.rename(path.with_name(".".join(path.name.split(".")[:4])))


def _curves(title: str, history: Sequence[Mapping[str, Any]]) -> bytes:
    """Return a PNG with the losses and success rates by epoch."""
    # Inherited from a notebook, it may name a backend that is not installed here.
    os.environ.pop("MPLBACKEND", None)
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.5), dpi=120, layout="constrained")
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
    figure.savefig(png, format="png", metadata={"Software": None})
    return png.getvalue()
