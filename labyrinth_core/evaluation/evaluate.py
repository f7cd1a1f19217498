"""`evaluate` any policy on a dataset.

from labyrinth_core import Dataset, evaluate

results = evaluate(policy, Dataset("data/labyrinth", "5x5"))
print(results)
results.save("results/mine.json", name="my method", url="https://example.org")
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from labyrinth_core.data.datasets import Dataset
from labyrinth_core.data.observations import ObservationSpec
from labyrinth_core.evaluation.answers import Player, fitted
from labyrinth_core.evaluation.baselines import TrainMemory
from labyrinth_core.evaluation.description import MOST_EPISODES, MOST_SEED
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays, arrays_in
from labyrinth_core.evaluation.playing import require_repeatable, step_through
from labyrinth_core.evaluation.replanner import replan
from labyrinth_core.evaluation.results import Results
from labyrinth_core.evaluation.scores import Scores, score
from labyrinth_core.world.labyrinth import Task, whole

NOT_EVALUATED = ("random",)
"""Splits that hold another policy's episodes in the labyrinths of train."""


def evaluate(
    policy: Any,
    source: str | Path | Dataset,
    config: str | None = None,
    *,
    observation: str | None = None,
    image_size: int | None = None,
    episodes: int | None = None,
    seed: int = 0,
    splits: Sequence[str] | None = None,
    revision: str | None = None,
) -> Results:
    """Return the results of a policy in the labyrinths of a dataset.

    A policy is one of the following. It answers with an array of NumPy, PyTorch or JAX: B actions,
    or scores of shape (B, 4), of which the highest counts.

    - A function from B observations to answers, or a PyTorch module, which is given tensors. It has
      no memory, so it is called once for each state of each labyrinth.
    - An object with `reset(count)` and `act(observations)`, which may have memory. All `count`
      episodes are stepped in lock-step; it still sees the final states of finished episodes, and
      its answers there are ignored.
    - Either of them, if the function or `reset` takes an argument `rng`: a
      `numpy.random.Generator`, for a stochastic policy. It is stepped, too.
    - A model or policy of Stable-Baselines3, or any object with its `predict`, called with
      `deterministic=True`. If it returns a state, it has memory and is stepped.

    A policy with attributes for what it has to be shown, such as those of `load_policy`, is shown
    that: see `labyrinth_core.evaluation.answers.fitted`.

    Args:
        policy: The policy to evaluate.
        source: A `Dataset`; or its folder, or its id on the Hub such as `user/labyrinth`.
        config: Name of the dataset's config, such as `5x5` or `5x5-key_and_door`; not with a
            `Dataset`.
        observation: What the policy is shown: "image", uint8 (B, image_size, image_size, 3);
            "vector", int32 (B, length); or "text", a list of B texts in the language of labyrinths,
            with the agent as `@`. None for the policy's own, or "image".
        image_size: Pixels on each side of the pictures. None for the policy's own, or 64.
        episodes: Number of episodes to step in each labyrinth, for a stochastic policy. None for
            look-ups if the policy allows them, else one episode.
        seed: Seed of the generator `rng`.
        splits: The splits to evaluate on; None for all but `random`.
        revision: Branch, tag or commit on the Hub; not for folders or with a `Dataset`.

    Raises:
        ValueError: An argument has a value that is not allowed.
        PolicyError: The policy is not one of these, raises an error, answers with anything but
            actions, or cannot be shown these labyrinths.
        DatasetError: The dataset or split does not exist, or was replaced meanwhile.
    """
    seed = whole("seed", seed, 0, MOST_SEED)
    if episodes is not None:
        episodes = whole("episodes", episodes, 1, MOST_EPISODES)
    data = Dataset.of(source, config, revision)
    about = data.manifest.config
    policy, spec = fitted(
        policy,
        about.height,
        about.width,
        about.task,
        observation=observation,
        image_size=image_size,
    )
    player = Player.of(policy, seed)

    def load(split: str, observation: str = spec.observation) -> LabyrinthArrays:
        shown = ObservationSpec(observation, spec.image_size, draw=True, resize=spec.resize)
        return arrays_in(data[split], shown)

    scores, baselines = judge(player, load, _chosen(splits, data), about.task, episodes=episodes)
    data.require_unchanged()
    return Results(
        dataset=str(data.source),
        revision=data.revision,
        config=about.name,
        fingerprint=data.fingerprint,
        observation=spec.observation,
        image_size=spec.image_size if spec.observation == "image" else None,
        way=way_of(player, episodes),
        episodes=episodes or 1,
        seed=seed,
        splits=scores,
        baselines=baselines,
    )


def way_of(player: Player, episodes: int | None = None) -> str:
    """Return how a policy is judged: `look-ups` if it remembers nothing, else `steps`."""
    return "look-ups" if player.forgets and episodes is None else "steps"


def judge(
    player: Player,
    load: Callable[..., LabyrinthArrays],
    splits: Iterable[str],
    task: Task,
    *,
    episodes: int | None = None,
    learnt: LabyrinthArrays | None = None,
    blind: bool = False,
) -> tuple[dict[str, Scores], dict[str, dict[str, Mapping[str, float]]]]:
    """Return the scores of a policy by split, and the figures of baselines by name and split.

    Args:
        player: The policy.
        load: Returns the labyrinths of a split, given its name, with the policy's observation or
            the one given as `observation`.
        splits: The names of the splits.
        task: The task of the labyrinths.
        episodes: As for `evaluate`.
        learnt: The labyrinths that the references know; None for all of the split train.
        blind: Whether to add the baselines that do not look at a labyrinth.
    """
    memory = TrainMemory.of(load("train", observation="vector") if learnt is None else learnt)
    scores: dict[str, Scores] = {}
    baselines: dict[str, dict[str, Mapping[str, float]]] = {}
    for split in splits:
        arrays = load(split)
        known, beside = memory.figures(arrays, blind=blind)
        if way_of(player, episodes) == "look-ups":
            advice = "give episodes=1 or more if it draws at random"
            require_repeatable(player, arrays, advice)
            found = score(player.act, arrays)
        else:
            found = Scores.of(step_through(player, arrays, episodes or 1), arrays)
        scores[split] = replace(found, known_route=known)
        del arrays  # Frees the arrays before those of the next split are loaded.
        if task.rules.hides:
            beside |= replan(load(split, observation="vector"))
        for name, figures in beside.items():
            baselines.setdefault(name, {})[split] = figures
    return scores, baselines


def _chosen(splits: Sequence[str] | None, data: Dataset) -> list[str]:
    if splits is None:
        return [split for split in data.splits if split not in NOT_EVALUATED]
    try:
        chosen = [splits] if isinstance(splits, str) else list(splits)
    except TypeError as error:
        raise ValueError(f"splits={splits!r:.60}: give names such as ['test']") from error
    for split in chosen or ["[]"]:
        data.manifest.of(split)  # Raises a DatasetError if there is no such split.
    return chosen
