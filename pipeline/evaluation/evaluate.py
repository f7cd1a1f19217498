"""The stage `evaluate`: evaluate a policy, print its results and write them to `results.json`.

The policy is the one of a job, whose folder gets the file, or any policy named by `policy=`, which
gets the folder `<run_dir>/<config>/<name>`. Nothing is selected or trained here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labyrinth_core import Dataset, PolicyError
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.evaluation.memorised import receipt_of
from labyrinth_core.evaluation.playing import attempts
from labyrinth_core.language.text import labyrinth_id
from labyrinth_core.pictures.animation import beside, frames_of, gif
from labyrinth_core.world.dynamics import replay
from labyrinth_core.world.solver import shortest_route
from pipeline.config.errors import ConfigError
from pipeline.config.options import source_of
from pipeline.config.stage import Job
from pipeline.evaluation.named import INSTEAD, OTHER_RUNS, Judged, judge_named
from pipeline.evaluation.options import EvaluateOptions
from pipeline.machinery.artifact import leave
from pipeline.machinery.console import say, say_once
from pipeline.machinery.folders import within

ATTEMPTS = "attempts"
"""The folder of animated GIFs, inside the folder of the results."""


def run(job: Job[EvaluateOptions]) -> None:
    """Evaluate the policy of a job, or the one that `policy` names.

    Raises:
        ConfigError: The policy or the device does not exist, or an option is not allowed.
        DatasetError: The run is not finished, the dataset has changed since it was trained, or a
            dataset or a split is missing.
        PolicyError: The policy raises an error, or returns anything but actions.
    """
    if job.options.policy:
        judged = judge_named(job)
    else:
        from pipeline.evaluation.trained import judge_trained  # It imports torch.

        judged = judge_trained(job)
    if job.options.evaluation.memorised:
        judged = _with_receipt(job, judged)
    path, files = judged.path, {judged.path.name: judged.results.to_text(judged.about).encode()}
    overwrite = job.options.overwrite
    instead = INSTEAD if job.options.policy else OTHER_RUNS
    leave(path.parent, files, key=judged.key, overwrite=overwrite, instead=instead)
    if job.options.evaluation.gifs:
        folder = path.parent / ATTEMPTS
        pictures = _pictures(judged, job.options.evaluation.gifs, job.dataset.seed)
        leave(within(path.parent, ATTEMPTS), pictures, overwrite=overwrite)
        say(f"{folder} has {len(pictures)} animated GIFs.")
    say(f"{judged.about.name}\n{judged.results.tables()}\n")
    if judged.results.memorised:
        say(f"{judged.results.memorised}\n")
    for part in judged.results.legend():
        say_once(part)
    say(str(path))


def _with_receipt(job: Job[EvaluateOptions], judged: Judged) -> Judged:
    """Add to results whether the policy follows the labyrinths of train it has learnt from.

    It is asked in test, or in validation if it is evaluated there alone.

    Raises:
        ConfigError: The dataset, or its number of labyrinths, allows no answer.
        PolicyError: The policy raises an error, or returns anything but actions.
    """
    asked = job.options.evaluation
    split = "test" if "test" in judged.results.splits else "validation"
    data = Dataset.of(source_of(job), job.dataset.name, job.options.revision)
    try:
        receipt = receipt_of(
            judged.player,
            judged.load(split),
            data,
            split=split,
            controls=asked.memorised or 0,
            train_labyrinths=job.options.first_labyrinths,
            episodes=asked.episodes,
        )
    except (DatasetError, PolicyError):
        raise
    except ValueError as error:
        raise ConfigError(f"evaluation.memorised={asked.memorised}: {error}") from error
    return judged._replace(results=replace(judged.results, memorised=receipt))


def _pictures(judged: Judged, count: int, seed: int) -> dict[str, bytes]:
    """Return GIFs of episodes in test, or in the first split evaluated; unsolved ones first.

    Each GIF shows the policy's episode next to an optimal one in the same labyrinth.
    """
    splits = judged.results.splits
    split = "test" if "test" in splits else next(iter(splits))
    solved = np.atleast_2d(splits[split].episodes.solved).min(axis=0)
    chosen = np.argsort(solved, kind="stable")[:count].tolist()
    pictures = {}
    for episode in attempts(judged.player, judged.load(split), chosen):
        labyrinth = episode.labyrinth
        optimal = replay(labyrinth, shortest_route(labyrinth, np.random.default_rng(seed)))
        picture = gif([beside(frames_of(episode), frames_of(optimal))])
        pictures[f"{labyrinth_id(labyrinth)}.gif"] = picture
    return pictures
