"""The stage `evaluate`: evaluate a policy, print its results and write them to `results.json`.

The policy is the one of a job, whose folder gets the file, or any policy named by `policy=`, which
gets the folder `<run_dir>/<config>/<name>`. Nothing is selected or trained here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labyrinth_core.data import SPLITS
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Evaluation, PolicyError, Results, RunName
from labyrinth_core.language import labyrinth_id
from labyrinth_core.pictures import animate
from labyrinth_core.world import Solver
from pipeline.config import ConfigError, Job, check
from pipeline.evaluation.named import Named, find_policy
from pipeline.evaluation.options import EvaluateOptions
from pipeline.machinery import leave, say, tracked, within

ATTEMPTS = "attempts"
"""The folder of animated GIFs, inside the folder of the results."""


def run(job: Job[EvaluateOptions]) -> None:
    """Evaluate the policy of a run, or the one that `policy` names.

    Raises:
        ConfigError: The policy or the device does not exist, or an option is not allowed.
        DatasetError: The run is not finished, the dataset has changed since it was trained, or a
            dataset or a split is missing.
        PolicyError: The policy raises an error, or returns anything but actions.
    """
    named = find_policy(job)
    results = results_of(job, named)
    if job.options.evaluation.memorised:
        results = _with_receipt(job, named.shown, results)
    path, files = named.path, {named.path.name: results.to_text(named.about).encode()}
    overwrite = job.options.overwrite
    leave(path.parent, files, key=named.key, overwrite=overwrite, instead=named.instead)
    if job.options.evaluation.gifs:
        folder = path.parent / ATTEMPTS
        pictures = _pictures(named.shown, results, job.options.evaluation.gifs, job.dataset.seed)
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


def results_of(job: Job[EvaluateOptions], named: Named | None = None) -> Results:
    """Play all episodes of a policy, the one of the job if none is given; return its results."""
    named = named or find_policy(job)
    shown, asked = named.shown, job.options.evaluation
    splits: Sequence[str] | None = asked.splits or None
    if shown.run is not None:
        splits = (*SPLITS.evaluated, *shown.data.manifest.config.shifts)
    return shown.results(
        splits,
        asked.episodes,
        trained_on=named.trained_on,
        follow=lambda each: tracked(((1, split) for split in each), "evaluate", len(each)),
    )


def _pictures(shown: Evaluation, results: Results, count: int, seed: int) -> dict[str, bytes]:
    """Return GIFs of episodes in test, or in the first split evaluated; unsolved ones first.

    Each GIF shows the policy's episode next to an optimal one in the same labyrinth.
    """
    splits = results.splits
    split = "test" if "test" in splits else next(iter(splits))
    solved = np.atleast_2d(splits[split].episodes.solved).min(axis=0)
    chosen = np.argsort(solved, kind="stable")[:count].tolist()
    pictures = {}
    for episode in shown.player.attempts(shown.load(split), chosen):
        labyrinth = episode.labyrinth
        optimal = labyrinth.replay(Solver(labyrinth).shortest_route(np.random.default_rng(seed)))
        picture = animate(episode, optimal)
        pictures[f"{labyrinth_id(labyrinth)}.gif"] = picture
    return pictures
