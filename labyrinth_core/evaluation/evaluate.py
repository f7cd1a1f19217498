"""`evaluate`: what anybody's policy achieves on a dataset.

from labyrinth_core import evaluate

results = evaluate(policy, "data/labyrinth", "5x5")
print(results)
results.save("results/mine.json", name="my method", url="https://example.org")
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.loader import DEFAULT_IMAGE_SIZE
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.source import locate
from labyrinth_core.evaluation.answers import PolicyError, decide
from labyrinth_core.evaluation.baselines import oracle_figures, random_figures
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays, load_arrays
from labyrinth_core.evaluation.references import TrainMemory
from labyrinth_core.evaluation.replanner import replan
from labyrinth_core.evaluation.results import Results
from labyrinth_core.evaluation.scores import Scores, score, stepped_score
from labyrinth_core.evaluation.stepping import Player
from labyrinth_core.world.labyrinth import Task

NOT_EVALUATED = ("random",)
"""Splits that hold another policy's episodes in the labyrinths of train."""

TRIED = 16
"""The number of states in which a policy is asked twice, to see that it answers alike."""


def evaluate(
    policy: Any,
    source: str | Path,
    config: str,
    *,
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    episodes: int | None = None,
    seed: int = 0,
    splits: Sequence[str] | None = None,
    revision: str | None = None,
) -> Results:
    """Return what a policy achieves in the labyrinths of a dataset.

    A policy is one of these. What it answers may be an array of numpy, PyTorch or JAX: B actions,
    or scores of shape (B, 4), of which the highest counts.

    - A function from B observations to answers, or a module of PyTorch, which is given tensors. It
      remembers nothing, so it is asked once about each state of each labyrinth.
    - An object with `reset(count)` and `act(observations)`, which may remember. Its episodes are
      stepped in lock-step, all `count` at once; when some are over, it still sees how they ended,
      and what it answers there is not looked at.
    - Either of them, if the function or `reset` has an argument `rng`: a `numpy.random.Generator`,
      for a policy that draws its actions at random. It is stepped, too.

    Args:
        policy: What is judged.
        source: Folder with the dataset, or its id on the Hub such as `user/labyrinth`.
        config: Name of the dataset's config, such as `5x5` or `5x5-key_and_door`.
        observation: What the policy is shown: "image", uint8 (B, image_size, image_size, 3);
            "vector", int32 (B, length); or "text", a list of B texts in the language of labyrinths,
            with the agent in them as `@`.
        image_size: Pixels on each side of the pictures.
        episodes: How many episodes to step in each labyrinth; for a policy that draws at random.
            None for look-ups where the policy allows them, else one.
        seed: Settles the generator `rng`.
        splits: The splits to evaluate on; None for all but `random`.
        revision: Branch, tag or commit on the Hub; not for folders.

    Raises:
        ValueError: An argument is none of the allowed values.
        PolicyError: The policy is no such thing, raises an error, or answers with anything but
            actions.
        DatasetError: There is no such dataset or split.
    """
    if episodes is not None and (type(episodes) is not int or episodes < 1):
        raise ValueError(f"episodes={episodes}: give a whole number from 1 on, or None")
    player = Player.of(policy, seed)
    looks_up = player.forgets and episodes is None
    manifest = Manifest.read(locate(source, config, [], revision))
    load = partial(load_arrays, source, config, revision=revision)
    chosen = _chosen(splits, manifest)
    memory = TrainMemory.of(load("train", observation="vector"))
    stepped = partial(stepped_score, episodes=episodes or 1)
    judge = partial(_looked_up if looks_up else stepped, player)
    scores: dict[str, Scores] = {}
    baselines: dict[str, dict[str, dict[str, float]]] = {}
    for split in chosen:
        # No name is given to the arrays, so that those of one split are gone before the next ones.
        scores[split], beside = _compared(
            judge, memory, load(split, observation=observation, image_size=image_size)
        )
        if manifest.config.task is Task.PARTIAL_OBSERVABILITY:
            beside |= replan(load(split, observation="vector"))
        for name, figures in beside.items():
            baselines.setdefault(name, {})[split] = figures
    return Results(
        dataset=str(source),
        revision=revision,
        config=config,
        fingerprint=manifest.fingerprint,
        observation=observation,
        image_size=image_size if observation == "image" else None,
        way="look-ups" if looks_up else "steps",
        episodes=episodes or 1,
        seed=seed,
        splits=scores,
        baselines=baselines,
    )


def _chosen(splits: Sequence[str] | None, manifest: Manifest) -> list[str]:
    held = list(dict.fromkeys(shard.split for shard in manifest.shards))
    if splits is None:
        return [split for split in held if split not in NOT_EVALUATED]
    chosen = [splits] if isinstance(splits, str) else list(splits)
    unknown = [split for split in chosen if split not in held]
    if unknown or not chosen:
        given = unknown[0] if unknown else "[]"
        raise DatasetError(f"split={given}: the dataset has {', '.join(held)}")
    return chosen


def _compared(
    judge: Callable[[LabyrinthArrays], Scores], memory: TrainMemory, arrays: LabyrinthArrays
) -> tuple[Scores, dict[str, dict[str, float]]]:
    """Return the scores on a split, and the figures of what needs no learning by name."""
    known, figures = memory.figures(arrays)
    figures |= {"random": random_figures(arrays), "oracle": oracle_figures(arrays)}
    return replace(judge(arrays), known_route=known), figures


def _looked_up(player: Player, arrays: LabyrinthArrays) -> Scores:
    """Return the scores by look-ups, if a policy that is asked twice answers alike."""
    some = np.flatnonzero(~arrays.terminal)[:TRIED]
    first, second = (decide(player.act, arrays.observations[some]) for _ in range(2))
    if not np.array_equal(first, second):
        raise PolicyError(
            "the policy answers the same observations differently: give episodes=1 or more if it "
            "draws at random, or reset(count) and act(observations) if it remembers"
        )
    return score(player.act, arrays)
