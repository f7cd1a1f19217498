"""Play a policy again, and compare its episodes with those that results claim."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import Dataset
from labyrinth_core.evaluation.evaluate import Evaluation
from labyrinth_core.evaluation.results import Results
from labyrinth_core.evaluation.scores import ACCURACIES

CLOSE = 1e-4
"""Scores of two actions that differ by at most this share of the greatest may fall another way on
another machine, which sums in another order; float32 has seven digits."""


def require_replay(results: Results, policy: Any, data: Dataset) -> None:
    """Play a policy and compare each episode with the one that results claim.

    A policy and a seed determine the episodes. Only where the scores of two actions are nearly
    equal may another processor or version of a library decide otherwise; the message then says so.

    Args:
        results: The results, of the dataset.
        policy: The policy that is said to have achieved them.
        data: The dataset.

    Raises:
        ValueError: An episode differs; the message names the first labyrinth.
        PolicyError: The policy fails, or cannot be shown these labyrinths.
    """
    shown = Evaluation.of(
        policy,
        data,
        observation=results.observation,
        image_size=results.image_size,
        seed=results.seed,
        run=results.run,
    )
    episodes = None if results.way == "look-ups" else results.episodes
    again = shown.results(list(results.splits), episodes)
    if again.way != results.way:
        raise ValueError(f"it.evaluated.way is {results.way}, but the policy plays by {again.way}")
    for split, scores in results.splits.items():
        claimed, played = scores.episodes, again.splits[split].episodes
        wrong = (claimed.outcomes != played.outcomes) | (claimed.moves != played.moves)
        for place in np.argwhere(np.atleast_2d(wrong))[:1].tolist():
            outcomes, moves = (
                [np.atleast_2d(getattr(each, name))[tuple(place)] for each in (claimed, played)]
                for name in ("outcomes", "moves")
            )
            near = _near_tie(shown, split, place[1]) if again.way == "look-ups" else ""
            raise ValueError(
                f"{split}: labyrinth {scores.labyrinth_ids[place[1]]:016x} is {outcomes[0]} after "
                f"{moves[0]} moves, but {outcomes[1]} after {moves[1]} when the policy plays "
                f"it{near}"
            )
        for name in ACCURACIES:
            told, right = getattr(scores, name), getattr(again.splits[split], name)
            if told != right:
                raise ValueError(f"{split}: {name} is {told}, but {right} when the policy plays")


def _near_tie(shown: Evaluation, split: str, labyrinth: int) -> str:
    """Say so if the scores of two actions are nearly equal where the policy goes in a labyrinth."""
    arrays = shown.load(split)
    state, visited = int(arrays.initial[labyrinth]), []
    gap = np.inf
    while state not in visited and not arrays.terminal[state]:
        visited.append(state)
        scores: NDArray[Any] = np.asarray(shown.player.act(arrays.observations[np.array([state])]))
        if scores.shape != (1, 4):
            return ""  # It answers with actions.
        second, first = np.sort(scores[0].astype(np.float64))[-2:]
        gap = min(gap, (first - second) / max(abs(first), 1e-12))
        state = int(arrays.next_state[state, scores[0].argmax()])
    if gap > CLOSE:
        return ""
    return (
        f"; there the scores of two actions differ by only {gap:.0e} of the greatest, so another "
        "machine may decide otherwise"
    )
