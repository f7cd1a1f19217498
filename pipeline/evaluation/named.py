"""Find the policy that the stage evaluates, and the place of its results.

A policy that no run trained needs no torch, so this module does not import it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from labyrinth_core.data import Dataset
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Description, Evaluation, PolicyError, Results
from labyrinth_core.policies import PolicyNameError, RunRecord, open_policy
from pipeline.config import ConfigError, Job
from pipeline.evaluation.options import EvaluateOptions, EvaluationOptions, described_by
from pipeline.machinery import Ownership, Sums

INSTEAD, OTHER_RUNS = "choose another evaluation.name", "choose another run_dir"


@dataclass(frozen=True)
class Named:
    """A policy to evaluate."""

    about: Description
    shown: Evaluation
    """The policy, with the dataset that it is evaluated on."""
    path: Path
    """The file for the results."""
    key: Mapping[str, Any]
    """Identifies the run or the policy that the folder of the results belongs to."""
    trained_on: Callable[[], Dataset] | None = None
    """Returns the dataset that the run learnt from; None for policies that no run trained."""

    @property
    def instead(self) -> str:
        """What to change if the results may not be written to `path`."""
        return INSTEAD if self.shown.run is None else OTHER_RUNS


def find_policy(job: Job[EvaluateOptions]) -> Named:
    """Return the policy of the option `policy`, or of the run that the other options describe.

    The folder of a run, under the run's name, stands for the run: its results are those of the
    run, unless an option `evaluation.*` describes the policy in another way.

    Raises:
        ConfigError: The policy or the device does not exist, or an option is not allowed.
        DatasetError: The run is not finished or another one, or a policy or a dataset cannot be
            read, or results of something else are where the new ones belong.
        PolicyError: The policy raises an error, or cannot be shown these labyrinths.
    """
    named = _of_options(job) if not job.options.policy else _by_name(job)
    own = Ownership(Sums.read(named.path.parent, overwrite=job.options.overwrite))
    own.require_free({named.path.name: b""}, named.key, job.options.overwrite, named.instead)
    return named


def _by_name(job: Job[EvaluateOptions]) -> Named:
    options = job.options
    data = job.open_dataset()  # Its error says how to make a dataset that is missing.
    policy = opened(options.policy)
    folder, run = Path(options.policy).expanduser(), getattr(policy, "run", None)
    # Under another name it is a copy, such as a download, whose results lie in `run_dir`.
    if run and folder.absolute().name == run.name and not described_by(options.evaluation):
        trained_on = partial(Dataset, run.dataset, run.config, run.revision)
        return _of_run(job, folder, data, trained_on)
    asked, name = options.evaluation, options.evaluation.name.strip() or Path(options.policy).name
    runs = Path(options.run_dir).expanduser() / job.dataset.name
    path = runs / _as_file_name(name) / Results.FILE
    if (
        not asked.name and path.with_name(RunRecord.FILE).exists()
    ):  # A run keeps its own results there.
        name = f"{name} as policy"
        path = runs / _as_file_name(name) / Results.FILE
    if path.with_name(RunRecord.FILE).exists():
        raise DatasetError(f"{path.parent} holds a trained run: {INSTEAD}")
    # "image" is the option's default, so it does not say what the policy observes.
    observation = None if options.observation == "image" else options.observation
    try:
        about = _description(name, asked)
        shown = Evaluation.of(
            policy,
            data,
            observation=observation,
            image_size=asked.image_size,
            seed=job.dataset.seed,
        )
    except PolicyError:
        raise
    except ValueError as error:
        raise ConfigError(str(error)) from error
    key = {"policy": options.policy.rstrip("/"), "name": name, "fingerprint": data.fingerprint}
    return Named(about, shown, path, key)


def _of_options(job: Job[EvaluateOptions]) -> Named:
    """Return the policy of the run that the options describe, on its dataset or `evaluate_on`."""
    from pipeline.training import require_run  # It imports torch.

    options, trained_on = job.options, job.open_dataset
    folder = options.run_folder(job.dataset)
    record = require_run(job, folder)
    fingerprint = record.content["run"]["fingerprint"]
    if options.evaluate_on:
        source, _, name = options.evaluate_on.rstrip("/").rpartition("/")
        return _of_run(job, folder, Dataset(source, name), trained_on, record)
    data = job.open_dataset(options.first_labyrinths)
    if data.fingerprint != fingerprint:
        raise DatasetError(
            f"{folder} was trained on another dataset than {data.source}: their fingerprints are "
            f"{fingerprint:.8} and {data.fingerprint:.8}; policy={folder} evaluates it on that "
            "dataset anyway"
        )
    return _of_run(job, folder, data, trained_on, record)


def _of_run(
    job: Job[EvaluateOptions],
    folder: Path,
    data: Dataset,
    trained_on: Callable[[], Dataset],
    record: RunRecord | None = None,
) -> Named:
    """Return the policy of a run, with the place of its results in the folder of the run."""
    from pipeline.training import show

    shown, key = show(job, folder, data, record)
    run, path = shown.run, folder / Results.FILE
    assert run is not None  # The results are those of the run.
    if run.fingerprint != data.fingerprint:
        path = path.with_stem(f"{path.stem}-{data.config}-{data.fingerprint:.8}")
    return Named(Description(run.name), shown, path, key, trained_on)


def opened(name: str) -> Any:
    """Return the policy that the option `policy` names; raise a ConfigError if it has no such form.

    For the other errors see `open_policy`.
    """
    try:
        return open_policy(name)
    except PolicyNameError as error:
        raise ConfigError(f"policy={name}: {error}") from error


def _description(name: str, asked: EvaluationOptions) -> Description:
    numbers = (asked.train_labyrinths, asked.train_steps, asked.parameters)
    details = dict(zip(Description.DETAILS, numbers, strict=True))
    stated = {what: number for what, number in details.items() if number is not None}
    return Description(name, asked.author, asked.url, asked.date, asked.budget, stated)


def _as_file_name(name: str) -> str:
    """Return a name that is safe in file systems and shells."""
    return re.sub(r"[^\w.-]+", "-", name).strip("-.") or "policy"
