"""Load the policy of a finished run, after comparing the run with the options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from labyrinth_core.data import Dataset
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Evaluation, Player, TrainedRun
from labyrinth_core.learning import PolicySpec
from labyrinth_core.pictures import ObservationSpec
from labyrinth_core.policies import RunRecord, open_policy
from pipeline.config import Job, TrainingOptions
from pipeline.training.identity import (
    choose_device,
    identify,
    options_of,
    require_same,
    spec_of,
    without_place,
)


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
        from pipeline.training.method import find

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
    from pipeline.training.checkpoint import read_policy
    from pipeline.training.method import find

    options, about, spec = job.options, data.manifest.config, spec_of(job)
    method, settings = find(options.method_name, values, options.protocol)
    spec.require_same_vectors(about.height, about.width, about.task)
    policy = read_policy(
        folder / PolicySpec.WEIGHTS, method, settings, spec, choose_device(options)
    )
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
