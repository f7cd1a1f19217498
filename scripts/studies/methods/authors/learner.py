"""The common base of the authors' methods: settings, optimizer, rows, evaluation during training.

A policy is evaluated on rows, and in episodes that are cut when they repeat states.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.optim import Adam

from labyrinth_core.evaluation import LabyrinthArrays
from labyrinth_core.evaluation.answers import Policy
from labyrinth_core.evaluation.playing import play
from labyrinth_core.evaluation.scores import Episodes, Scores
from labyrinth_core.learning.learner import BaseSettings, Learner, setting
from labyrinth_core.learning.networks.acting import BATCH
from labyrinth_core.learning.networks.network import ACTIONS
from labyrinth_core.learning.problem import Steps, draw, parts_of

VISITS = 5
"""An episode is cut when the agent returns to a state in which it has acted this many times."""


@dataclass(frozen=True)
class Settings(BaseSettings):
    """Unlike in other methods, a batch may be a single row, and is by default."""

    epochs: int = 5000
    evaluate_every: int = 100
    batch_size: int = setting(1, "number of rows in a gradient step", at_least=1)


class AuthorsLearner(Learner):
    """A method of the authors; keeps the policy with the best accuracy on validation rows."""

    selected_by = "validation_accuracy"
    """The metric by which the best policy is selected; higher is better."""
    protocol = "authors"
    visits: int | None = VISITS
    """The argument `visits` of `try_out`."""

    def adam(self, network: nn.Module) -> Adam:
        # Fused, because Adam takes most of the time of a step with one row.
        return Adam(network.parameters(), lr=self.settings.learning_rate, fused=True)

    @classmethod
    def chances(cls, scores: Tensor) -> NDArray[np.float64]:
        """Return the action probabilities of a trained policy, shape (S, 4)."""
        certain: NDArray[np.float64] = np.eye(ACTIONS)[scores.argmax(1).cpu().numpy()]
        return certain

    @classmethod
    def chances_in_training(cls, scores: Tensor) -> NDArray[np.float64]:
        """Return the action probabilities of a policy during training, shape (S, 4)."""
        return cls.chances(scores)

    @classmethod
    def figures(
        cls, policy: Policy, train: LabyrinthArrays, validation: LabyrinthArrays
    ) -> dict[str, float]:
        # A fixed seed of its own, so that evaluation does not change training.
        rng = np.random.default_rng(0)
        of_train, of_validation = (
            cls.chances_in_training(_scores(policy, arrays)) for arrays in (train, validation)
        )
        episodes, _ = try_out(train, of_train, rng, cls.visits)
        rows = rows_of(validation)
        return {
            "validation_accuracy": float(
                (draw(of_validation[rows.states], rng) == rows.actions).mean()
            ),
            "train_return": float(episodes.returns.mean()),
        }

    @classmethod
    def is_better(cls, figures: Mapping[str, float], best: Mapping[str, float]) -> bool:
        """Return whether a metric is higher: of equally good policies the first is kept."""
        return figures[cls.selected_by] > best[cls.selected_by]

    @classmethod
    def as_tried(cls, policy: Policy, arrays: LabyrinthArrays) -> dict[str, float]:
        """Return the figures of a policy as the code tries it, for `try_authors.py`."""
        chances = cls.chances(_scores(policy, arrays))
        episodes, _ = try_out(arrays, chances, np.random.default_rng(0), cls.visits)
        return Scores.of(episodes, arrays).summary()


def _scores(policy: Policy, arrays: LabyrinthArrays) -> Tensor:
    """Return a policy's scores in all states, of which more may exist than fit into memory."""
    parts = parts_of(len(arrays.observations), BATCH)
    return torch.cat([torch.as_tensor(policy(arrays.observations[part])) for part in parts])


def rows_of(arrays: LabyrinthArrays) -> Steps:
    """Return the rows of all episodes of a split, in order: its steps and its last states.

    The row of a last state repeats the action of the previous row; its next state is the goal.
    """
    states, actions = [], []
    for start, route in zip(arrays.route_starts.tolist(), arrays.routes, strict=True):
        states.append(start)
        for action in route.tolist():
            states.append(int(arrays.next_state[states[-1], action]))
        actions += [*route.tolist(), int(route[-1])]
    return Steps(np.array(states), np.array(actions), arrays.next_state[states, actions])


def try_out(
    arrays: LabyrinthArrays,
    probabilities: NDArray[np.float64],
    rng: np.random.Generator,
    visits: int | None = VISITS,
) -> tuple[Episodes, NDArray[np.int64]]:
    """Let a policy play one episode in each labyrinth.

    Args:
        arrays: The labyrinths.
        probabilities: The probability of each action in each state, shape (S, 4).
        rng: The source of the actions.
        visits: An episode is cut, as if at the step limit, when the agent returns to a state in
            which it has acted this many times; None for the step limit only.

    Returns:
        The results, and all steps as rows (s, a, s'), shape (N, 3).
    """
    taken = [np.zeros((0, 3), np.int64)]

    def choose(state: NDArray[np.int64], running: NDArray[np.int64]) -> NDArray[np.int64]:
        here = state[running]
        actions = draw(probabilities[here], rng)
        taken.append(np.stack([here, actions, arrays.next_state[here, actions]], axis=1))
        return actions

    begun = np.bincount(arrays.initial, minlength=len(arrays.terminal))

    def first_seen(
        step: int,
        running: NDArray[np.int64],  # noqa: ARG001
        states: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        seen = begun[states] >= (np.inf if visits is None else visits)
        begun[states] += 1
        return np.where(seen, 0, step)

    return play(arrays, choose, first_seen=first_seen), np.concatenate(taken)
