"""Load the policy of a run of the stage `train`, after comparing the run with the options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from labyrinth_core.data import Dataset
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Evaluation, Player, TrainedRun
from labyrinth_core.learning.networks.network import usual_defaults
from labyrinth_core.learning.spec import WEIGHTS, PolicySpec
from labyrinth_core.pictures.observations import ObservationSpec
from labyrinth_core.policies.opening import open_policy
from labyrinth_core.policies.record import read_run, trained_run
from pipeline.config.stage import Job
from pipeline.evaluation.options import EvaluateOptions
from pipeline.training.identity import (
    choose_device,
    identify,
    options_of,
    require_same,
    spec_of,
    without_place,
)


def require_run(job: Job[EvaluateOptions], folder: Path) -> Mapping[str, Any]:
    """Return the record of a finished run, which the options describe.

    Raises:
        DatasetError: The run is not finished, or was trained with other options.
    """
    record = read_run(folder)
    if record is None:
        raise DatasetError(f"{folder} holds no finished run: stages=train makes it")
    options, about = job.options, record["run"]
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


@usual_defaults()
def show(
    job: Job[EvaluateOptions], folder: Path, data: Dataset, record: Mapping[str, Any] | None = None
) -> tuple[Evaluation, dict[str, Any]]:
    """Return the policy of a run with a dataset, on the chosen device, and the run's key.

    Args:
        job: The options.
        folder: The folder of the run.
        data: The dataset that it is evaluated on.
        record: The record of the run, if it has been read.

    Raises:
        ConfigError: The device does not exist.
        DatasetError: The run is not finished, or damaged.
        PolicyError: The policy cannot be shown the labyrinths of the dataset.
    """
    device, record = choose_device(job.options), record or read_run(folder)
    assert record is not None  # Else there was no run.
    run = trained_run(record, device.type)
    key = options_of(record["run"])
    if not job.options.policy and ":" in job.options.method_name:
        return _of_users_method(job, folder, data, run, record["run"]["settings"]), key
    policy = open_policy(folder)
    policy.network.to(device)
    return Evaluation.of(policy, data, run=run), key


def _of_users_method(
    job: Job[EvaluateOptions],
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
    if options.observation == "vector":
        PolicySpec(spec, average=False).require_fit(about.height, about.width, about.task)
    make = partial(method.make, settings=settings)
    policy = read_policy(folder / WEIGHTS, spec, choose_device(options), make)
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
