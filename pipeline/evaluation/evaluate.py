"""The stage `evaluate`: evaluate a policy, print its results and write them to `results.json`.

The policy is the one of a job, whose folder gets the file, or any policy named by `policy=`, which
gets the folder `<run_dir>/<config>/<name>`. Nothing is selected or trained here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from labyrinth_core.data import SPLITS, Dataset
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Description, Evaluation, PolicyError, Results, RunName
from labyrinth_core.language import labyrinth_id
from labyrinth_core.policies import PolicyNameError, RunRecord, open_policy
from labyrinth_core.world import Solver
from pipeline.config import ConfigError, Job, check
from pipeline.evaluation.options import EvaluateOptions, EvaluationOptions, described_by
from pipeline.machinery import Ownership, Sums, leave, say, tracked, within

ATTEMPTS = "attempts"
"""The folder of animated GIFs, inside the folder of the results."""


def run(job: Job[EvaluateOptions]) -> None:
    """Evaluate the policy of a run, or the one that `policy` names.

    The folder of a run, under the run's name, stands for the run: its results are those of the
    run, unless an option `evaluation.*` describes the policy in another way.

    Raises:
        ConfigError: The policy or the device does not exist, or an option is not allowed.
        DatasetError: The run is not finished or another one, the dataset has changed since it was
            trained, a policy, a dataset or a split cannot be read, or results of something else
            are where the new ones belong.
        PolicyError: The policy raises an error, returns anything but actions, or cannot be shown
            these labyrinths.
    """
    asked, overwrite = job.options.evaluation, job.options.overwrite
    named = _by_name(job) if job.options.policy else _of_options(job)
    own = Ownership(Sums.read(named.path.parent, overwrite=overwrite))
    own.require_free({named.path.name: b""}, named.key, overwrite, named.instead)
    shown, splits = named.shown, asked.splits or None
    if shown.run is not None:
        splits = (*SPLITS.evaluated, *shown.data.manifest.config.shifts)
    results = shown.results(
        splits,
        asked.episodes,
        trained_on=named.trained_on,
        follow=lambda each: tracked(each, "evaluate", len(each)),
    )
    if asked.memorised:
        results = _with_receipt(job, shown, results)
    path, files = named.path, {named.path.name: results.to_text(named.about).encode()}
    leave(path.parent, files, key=named.key, overwrite=overwrite, instead=named.instead)
    if asked.gifs:
        folder = path.parent / ATTEMPTS
        pictures = _pictures(shown, results, asked.gifs, job.dataset.seed)
        leave(within(path.parent, ATTEMPTS), pictures, overwrite=overwrite)
        say(f"{folder} has {len(pictures)} animated GIFs.")
    say(f"{named.about.name}\n{results.tables()}\n")
    if results.memorised:
        say(f"{results.memorised}\n")
    for part in results.legend():
        say(part, once=True)
    say(str(path))


def _with_receipt(job: Job[EvaluateOptions], shown: Evaluation, results: Results) -> Results:
    """Add to results whether the policy follows the labyrinths of train it has learnt from.

    It is asked in test, or in validation if it is evaluated there alone.

    Raises:
        ConfigError: The dataset, or its number of labyrinths, allows no answer, or the policy has
            not learnt from train of this dataset.
        PolicyError: The policy raises an error, or returns anything but actions.
    """
    asked, run = job.options.evaluation, shown.run
    option = f"evaluation.memorised={asked.memorised}"
    if run is not None:
        own = run.fingerprint == shown.data.fingerprint and run.train_labyrinths != RunName.FRESH
        check(own, f"{option}: {run.name} has not learnt from train of {shown.data.source}")
    split = "test" if "test" in results.splits else "validation"
    learnt = job.options.first_labyrinths if run is None else run.first_labyrinths
    try:
        receipt = shown.receipt(
            split, asked.memorised or 0, train_labyrinths=learnt, episodes=asked.episodes
        )
    except (DatasetError, PolicyError):
        raise
    except ValueError as error:
        raise ConfigError(f"{option}: {error}") from error
    return replace(results, memorised=receipt)


def _pictures(shown: Evaluation, results: Results, count: int, seed: int) -> dict[str, bytes]:
    """Return GIFs of episodes in test, or in the first split evaluated; unsolved ones first.

    Each GIF shows the policy's episode next to an optimal one in the same labyrinth.
    """
    from labyrinth_core.pictures import animate  # It imports Pillow.

    splits = results.splits
    split = "test" if "test" in splits else next(iter(splits))
    solved = np.atleast_2d(splits[split].episodes.solved).min(axis=0)
    chosen = np.argsort(solved, kind="stable")[:count].tolist()
    pictures = {}
    for episode in shown.player.attempts(shown.load(split), chosen):
        labyrinth = episode.labyrinth
        optimal = labyrinth.replay(Solver(labyrinth).shortest_route(np.random.default_rng(seed)))
        pictures[f"{labyrinth_id(labyrinth)}.gif"] = animate(episode, optimal)
    return pictures


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


def _by_name(job: Job[EvaluateOptions]) -> Named:
    options = job.options
    data = job.open_dataset()  # Its error says how to make a dataset that is missing.
    try:
        policy = open_policy(options.policy)
    except PolicyNameError as error:
        raise ConfigError(f"policy={options.policy}: {error}") from error
    folder, run = Path(options.policy).expanduser(), getattr(policy, "run", None)
    # Under another name it is a copy, such as a download, whose results lie in `run_dir`.
    if run and folder.absolute().name == run.name and not described_by(options.evaluation):
        trained_on = partial(Dataset, run.dataset, run.config, run.revision)
        return _of_run(job, folder, data, trained_on)
    asked, name = options.evaluation, options.evaluation.name.strip() or Path(options.policy).name
    runs = Path(options.run_dir).expanduser() / job.dataset.name
    path = runs / _as_file_name(name) / Results.FILE
    if not asked.name and path.with_name(RunRecord.FILE).exists():
        # A run keeps its own results there.
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


def _description(name: str, asked: EvaluationOptions) -> Description:
    numbers = (asked.train_labyrinths, asked.train_steps, asked.parameters)
    details = dict(zip(Description.DETAILS, numbers, strict=True))
    stated = {what: number for what, number in details.items() if number is not None}
    return Description(name, asked.author, asked.url, asked.date, asked.budget, stated)


def _as_file_name(name: str) -> str:
    """Return a name that is safe in file systems and shells."""
    return re.sub(r"[^\w.-]+", "-", name).strip("-.") or "policy"
