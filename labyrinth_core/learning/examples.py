"""Training examples from demonstrated episodes, as they are or relabelled.

Relabelling takes any two states of an episode as start and goal: a part of a shortest route is a
shortest route, so it demonstrates the way between its ends (hindsight: Kaelbling 1993; Andrychowicz
et al. 2017). Where every move can be undone, the reversed part is a demonstration, too. In
labyrinths with a door nothing is reversed, and a part is used only if it is a complete episode of
the labyrinth with the new start and goal, from before the key to behind the door; an episode
without such a part is used whole. The picture with the new start and goal is drawn from `info`,
which adds nothing to what the demonstration's own pictures show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation import LabyrinthArrays
from labyrinth_core.world import Episode, Labyrinth, State

NO_LABEL = -1

KEPT_EPISODES = 10_000
"""The number of replayed episodes to keep: each takes some 4 KB at 5x5."""


class ExampleSampler:
    """Samples training examples from the demonstrated episodes."""

    def __init__(self, arrays: LabyrinthArrays) -> None:
        """Sample from the episodes of `arrays`, which are replayed when they are drawn."""
        self._arrays = arrays

        @lru_cache(KEPT_EPISODES)
        def episode(number: int) -> Episode:
            of = arrays.labyrinth[arrays.route_starts[number]]
            return arrays.labyrinths[int(of)].replay(arrays.routes[number].tolist())

        self.episode = episode
        """Returns an episode by its number."""
        self.parts = lru_cache(KEPT_EPISODES)(lambda number: Parts(episode(number)))
        """Returns the parts of an episode by its number."""

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self._arrays.routes)

    def draw(
        self, count: int, rng: np.random.Generator, *, relabel: bool, whole: bool
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """Sample states of episodes, or of parts of episodes; return their pictures and labels.

        Args:
            count: The number of examples N, at least 1.
            rng: The source of the sample.
            relabel: Whether to take a part between two states of an episode, or all of it.
            whole: Whether to label all cells of the part, or only the agent's. Under partial
                observability only the agent's cell is labelled. If the agent has the key, labels
                are the actions taken with the key, else those taken without it.

        Returns:
            The pictures, shape (N, size, size, 3), and the labels: the agent's actions, shape (N,),
            or the actions in every cell, shape (N, height, width), rows from the top, `NO_LABEL`
            where no action is demonstrated.
        """
        drawn = [self.example(rng, relabel, whole) for _ in range(count)]
        views, labels = zip(*drawn, strict=True)
        return self._arrays.spec.look(views), np.stack(labels)

    def example(
        self, rng: np.random.Generator, relabel: bool, whole: bool
    ) -> tuple[tuple[Labyrinth, State], NDArray[np.int64]]:
        """Return a random example: a labyrinth with a state, and the label."""
        number = int(rng.integers(len(self)))
        episode = self.episode(number)
        first, last, labyrinth = 0, len(episode), episode.labyrinth
        if relabel and (parts := self.parts(number)):
            first, last = parts[int(rng.integers(len(parts)))]
            start, goal = episode.states[first].agent, episode.states[last].agent
            labyrinth = replace(labyrinth, start=start, goal=goal)
        step = 1 if first < last else -1
        agent = first + step * int(rng.integers(abs(last - first)))
        state = episode.states[agent]
        if not whole:
            return (labyrinth, state), np.array(_action(episode, agent, step))
        structure = labyrinth.structure
        labels = np.full(structure.cells, NO_LABEL)
        hidden = labyrinth.task.rules.hides
        for index in [agent] if hidden else range(first, last, step):
            there = episode.states[index]
            if there[1:] == state[1:]:
                labels[there.agent] = _action(episode, index, step)
        rows = labels.reshape(structure.height, structure.width)[::-1]
        return (labyrinth, state), rows


def _action(episode: Episode, index: int, step: int) -> int:
    """Return the action in a state of an episode, or for `step` -1 the one that undoes the last."""
    return int(episode.actions[index] if step > 0 else (episode.actions[index - 1] + 2) % 4)


class Parts(Sequence[tuple[int, int]]):
    """The index pairs of the states of an episode that can be start and goal, in ascending order.

    An episode of T actions has up to T (T + 1) pairs, so only their number per start is stored.
    """

    def __init__(self, episode: Episode) -> None:
        labyrinth, door = episode.labyrinth, episode.labyrinth.door
        self._cells = np.array([state.agent for state in episode.states])
        self._forward = True
        """Whether the goal has to come after the start."""
        if labyrinth.task.rules.is_reversible or door is None:
            self._goals = ~np.isin(self._cells, [*labyrinth.ice])
            starts = self._goals
            self._forward = bool((np.diff(self._cells) == 0).any())  # A bump cannot be undone.
        else:
            starts = np.array([not state.has_key for state in episode.states])
            before_door = np.array(labyrinth.structure.distances(labyrinth.start, [door]))
            behind = (before_door[self._cells] < 0) & (self._cells != door)
            first_visits = np.zeros(len(self._cells), np.bool_)
            first_visits[np.unique(self._cells, return_index=True)[1]] = True
            self._goals = behind & first_visits
        counts = [len(self._goals_of(first)) if start else 0 for first, start in enumerate(starts)]
        self._bounds = np.cumsum([0, *counts])

    def __len__(self) -> int:
        return int(self._bounds[-1])

    def __getitem__(self, number: Any) -> Any:
        if not 0 <= number < len(self):
            raise IndexError(number)
        first = int(self._bounds.searchsorted(number, "right")) - 1
        return first, int(self._goals_of(first)[number - self._bounds[first]])

    def _goals_of(self, first: int) -> NDArray[np.int64]:
        """Return the indices of the states that can be the goal of a start."""
        goals = self._goals & (self._cells != self._cells[first])
        if self._forward:
            goals[: first + 1] = False
        return np.flatnonzero(goals)
