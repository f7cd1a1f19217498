"""A finished run: its record `run.json`, its learning curves, and its policy, opened again."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from labyrinth_core.data import Dataset
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.evaluation import Evaluation, Player, Results, TrainedRun
from labyrinth_core.learning import PolicySpec
from labyrinth_core.pictures import ObservationSpec
from labyrinth_core.policies import RunRecord, open_policy, read_tensors
from labyrinth_core.storage import File
from pipeline.config import ConfigError, Job, TrainingOptions
from pipeline.machinery import Sums, leave, say
from pipeline.training.identity import (
    choose_device,
    find,
    identify,
    options_of,
    require_same,
    spec_of,
    without_place,
)
from pipeline.training.loop import Progress

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


def require_run(job: Job[TrainingOptions], folder: Path) -> RunRecord:
    """Return the record of a finished run, which the options describe.

    Raises:
        DatasetError: The run is not finished, or was trained with other options.
    """
    record = _record_in(folder)
    options, about = job.options, record.content["run"]
    named = identify(job, about["settings"], about["fingerprint"])
    another = ": move it elsewhere, or replace it with stages=train overwrite=true"
    require_same(f"{folder} was trained", without_place(about), without_place(named), another)
    if options.method.keys() > {"name"}:
        settings = {**about["settings"], **options.method}
        _, asked = find(options.method_name, settings, options.protocol)
        advice = ": leave the option out, or train with it first"
        require_same(f"{folder} was trained", about, about | {"settings": asdict(asked)}, advice)
    return record


def show(
    job: Job[TrainingOptions], folder: Path, data: Dataset, record: RunRecord | None = None
) -> tuple[Evaluation, dict[str, Any]]:
    """Return the policy of a run with a dataset, on the chosen device, and the run's key.

    Args:
        job: The options.
        folder: The folder of the run.
        data: The dataset that it is evaluated on.
        record: The record of the run, if the options describe it: they name its method, too.

    Raises:
        ConfigError: The device does not exist.
        DatasetError: The run is not finished, or damaged.
        PolicyError: The policy cannot be shown the labyrinths of the dataset.
    """
    device, found = choose_device(job.options), record or _record_in(folder)
    run, made = found.trained_run(device.type), found.content["run"]
    if record is not None and ":" in job.options.method_name:
        return _of_users_method(job, folder, data, run, made["settings"]), options_of(made)
    policy = open_policy(folder)
    policy.network.to(device)
    return Evaluation.of(policy, data, run=run), options_of(made)


def _record_in(folder: Path) -> RunRecord:
    record = RunRecord.read(folder)
    if record is None:
        raise DatasetError(f"{folder} holds no finished run: stages=train makes it")
    return record


def _of_users_method(
    job: Job[TrainingOptions],
    folder: Path,
    data: Dataset,
    run: TrainedRun,
    values: Mapping[str, Any],
) -> Evaluation:
    """Return the policy of a user's method, which may have its own network and memory.

    Args:
        job: The options, which name the method.
        folder: The folder of the run.
        data: The dataset that it is evaluated on.
        run: The run.
        values: The settings of the method in the run.
    """
    options, about, spec = job.options, data.manifest.config, spec_of(job)
    method, settings = find(options.method_name, values, options.protocol)
    spec.require_same_vectors(about.height, about.width, about.task)
    path = folder / PolicySpec.WEIGHTS
    try:
        policy = method.trained(read_tensors(path)[0], spec, settings, choose_device(options))
    except (OSError, ValueError, RuntimeError) as error:
        reason = f"{path} is not a policy of this network"
        raise DatasetError(f"{reason}: {one_line(error):.300}") from error
    size = method.image_size(spec, settings, about.height, about.width)
    resize = options.resize
    shape = replace(spec, height=about.height, width=about.width)
    return Evaluation(
        data,
        Player.of(method.player(policy, shape, settings), run.seed),
        ObservationSpec(options.observation, size, draw=True, resize=resize),
        run.seed,
        run=run,
    )
