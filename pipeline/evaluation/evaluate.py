"""The stage `evaluate`: what a policy achieves, printed and kept as `results.json`.

The policy is that of a run, or any other that `policy=` names. The file lies in the folder of the
run, or in `<run_dir>/<config>/<name>`. Nothing is selected or learnt here.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from labyrinth_core.evaluation.playing import attempts
from labyrinth_core.language.text import labyrinth_id
from labyrinth_core.pictures.animation import beside, frames_of, gif
from labyrinth_core.world.dynamics import replay
from labyrinth_core.world.solver import shortest_route
from pipeline.config.run import Run
from pipeline.evaluation.named import INSTEAD, Judged, judge_named
from pipeline.machinery.artifact import leave
from pipeline.machinery.console import say, say_once

ATTEMPTS = "attempts"
"""The folder of moving pictures, in that of the results."""


def run(run: Run) -> None:
    """Evaluate the policy of a run, or the one that `policy` names.

    Raises:
        ConfigError: There is no such policy or device, or an option is impossible.
        DatasetError: There is no finished run, it was trained on another dataset than the one that
            exists now, or a dataset or a split is missing.
        PolicyError: The policy raises an error, or answers with anything but actions.
    """
    if run.options.policy:
        judged = judge_named(run)
    else:
        from pipeline.evaluation.trained import judge_trained  # It imports torch.

        judged = judge_trained(run)
    path, files = judged.path, {judged.path.name: judged.results.to_text(judged.about).encode()}
    overwrite = run.options.overwrite
    leave(path.parent, files, key=judged.key, overwrite=overwrite, instead=INSTEAD)
    if run.options.evaluation.gifs:
        folder = path.parent / ATTEMPTS
        written = _show(judged, folder, run.options.evaluation.gifs, run.options.seed)
        say(f"{folder} has {written} moving pictures.")
    say(f"{judged.about.name}\n{judged.results.tables()}\n")
    for part in judged.results.legend():
        say_once(part)
    say(str(path))


def _show(judged: Judged, folder: Path, count: int, seed: int) -> int:
    """Write moving pictures of episodes in test, or in the first split that was evaluated.

    They show the first labyrinths that were not solved, then the first that were, each beside an
    optimal episode in the same labyrinth.
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
    leave(folder, pictures)
    return len(chosen)
