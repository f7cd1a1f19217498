"""The stage `evaluate` where `policy=` names a policy: what it achieves, printed and kept.

The results lie in `<run_dir>/<config>/<name>/results.json`.
"""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from labyrinth_core import evaluate
from labyrinth_core.evaluation.answers import PolicyError
from labyrinth_core.evaluation.description import DETAILS, Description
from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
from labyrinth_core.evaluation.results import Results
from labyrinth_core.evaluation.stepping import Player
from pipeline.config.errors import ConfigError
from pipeline.config.run import Run
from pipeline.config.training import EvaluationOptions
from pipeline.evaluation.named import named_policy
from pipeline.machinery.console import say
from pipeline.machinery.dataset import fingerprint_of
from pipeline.machinery.evaluation_file import RESULTS
from pipeline.machinery.moving_pictures import write_attempts


def run(run: Run) -> None:
    """Evaluate the policy that is named.

    Raises:
        ConfigError: There is no such policy, or an option is impossible.
        DatasetError: There is no such archive or dataset, or a split is missing.
        PolicyError: The policy raises an error, or answers with anything but actions.
    """
    options, asked = run.options, run.options.evaluation
    name = asked.name.strip() or Path(options.policy).name.removesuffix(".zip")
    folder = Path(options.run_dir).expanduser() / run.dataset.name / _as_file_name(name)
    fingerprint_of(run)  # Says how the dataset is made, if there is none.
    policy = named_policy(options.policy)
    try:
        about = _description(name, asked)  # First, as the evaluation may take long.
        results = evaluate(
            policy,
            run.source,
            run.dataset.name,
            observation=options.observation,
            image_size=asked.image_size,
            episodes=asked.episodes,
            seed=options.seed,
            splits=asked.splits or None,
            revision=options.revision,
        )
        results.save(folder / RESULTS, **asdict(about))
        if asked.gifs:
            _show(run, policy, results, folder)
    except PolicyError:
        raise
    except ValueError as error:
        raise ConfigError(str(error)) from error
    say(f"{name}\n{results}\n{folder / RESULTS}")


def _show(run: Run, policy: Any, results: Results, folder: Path) -> None:
    """Leave moving pictures of the policy in test, or in the first split that was evaluated."""
    options, split = run.options, "test" if "test" in results.splits else next(iter(results.splits))
    arrays = load_arrays(
        run.source,
        run.dataset.name,
        split,
        observation=options.observation,
        image_size=options.evaluation.image_size,
        revision=options.revision,
    )
    solved = np.atleast_2d(results.splits[split].episodes.solved).min(axis=0)
    count, seed = options.evaluation.gifs, options.seed
    paths = write_attempts(folder, Player.of(policy, seed), arrays, solved, count, seed)
    say(f"{paths[0].parent} has {len(paths)} moving pictures.")


def _description(name: str, asked: EvaluationOptions) -> Description:
    numbers = (asked.train_labyrinths, asked.train_steps, asked.parameters)
    details = dict(zip(DETAILS, numbers, strict=True))
    stated = {what: number for what, number in details.items() if number is not None}
    return Description(name, asked.author, asked.url, asked.date, asked.budget, stated)


def _as_file_name(name: str) -> str:
    """Return a name without what file systems and shells do not like."""
    return re.sub(r"[^\w.-]+", "-", name).strip("-.") or "policy"
