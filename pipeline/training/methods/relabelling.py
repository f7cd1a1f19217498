"""Training examples from demonstrated episodes, as they are or relabelled.

Relabelling takes any two states of an episode as start and goal: a part of a shortest route is a
shortest route, so it demonstrates the way between its ends (hindsight: Kaelbling 1993; Andrychowicz
et al. 2017). Where every move can be undone, the reversed part is a demonstration, too. With a door
it is not: there nothing is reversed, and a part is taken only if it is a complete episode of the
labyrinth with the new start and goal, from before the key to behind the door. The picture with the
new start and goal is drawn from `info`, which adds nothing that the demonstration's own pictures do
not show.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.world.dynamics import State
from labyrinth_core.world.labyrinth import Labyrinth, Task
from labyrinth_core.world.rollout import Episode, replay
from pipeline.training.methods.acting import Steps

NO_LABEL = -1


class ExampleSampler:
    """Draws examples from the demonstrated episodes."""

    def __init__(self, arrays: LabyrinthArrays, demonstrations: Steps) -> None:
        """Replay the episodes; `demonstrations` are the steps of `arrays.routes`, in order."""
        self._spec = arrays.spec
        firsts = np.cumsum([0, *map(len, arrays.routes)])[:-1]
        numbers = arrays.labyrinth[demonstrations.states[firsts]].tolist()
        self._episodes = [
            replay(arrays.labyrinths[number], route.tolist())
            for number, route in zip(numbers, arrays.routes, strict=True)
        ]
        self._parts = [_parts(episode) for episode in self._episodes]

    def draw(
        self, count: int, rng: np.random.Generator, *, relabel: bool, whole: bool
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """Return pictures of states on parts of episodes, all at random, and their labels.

        The shape of the pictures is (N, size, size, 3). The labels are the agent's actions, shape
        (N,); or the actions in every cell, shape (N, height, width), rows from the top, with
        `NO_LABEL` where none is demonstrated.

        Args:
            count: The number of examples, at least 1.
            rng: Draws them.
            relabel: Whether the part is between any two states of the episode, or all of it.
            whole: Whether the labels are the actions in all cells of the part, or the agent's
                action alone. Cells are labelled only if the agent can see them, and with the
                actions taken with the key if the agent has it, else with those without it.
        """
        drawn = [self._example(rng, relabel, whole) for _ in range(count)]
        views, labels = zip(*drawn, strict=True)
        return self._spec.look(views), np.stack(labels)

    def _example(
        self, rng: np.random.Generator, relabel: bool, whole: bool
    ) -> tuple[tuple[Labyrinth, State], NDArray[np.int64]]:
        number = rng.integers(len(self._episodes))
        episode, parts = self._episodes[number], self._parts[number]
        first, last = parts[rng.integers(len(parts))] if relabel else (0, len(episode))
        step = 1 if first < last else -1
        agent = first + step * int(rng.integers(abs(last - first)))
        state, labyrinth = episode.states[agent], _with_ends(episode, first, last)
        if not whole:
            return (labyrinth, state), np.array(_action(episode, agent, step))
        structure = labyrinth.structure
        labels = np.full(structure.cells, NO_LABEL)
        hidden = labyrinth.task is Task.PARTIAL_OBSERVABILITY
        for index in [agent] if hidden else range(first, last, step):
            there = episode.states[index]
            if there[1:] == state[1:]:
                labels[there.agent] = _action(episode, index, step)
        return (labyrinth, state), labels.reshape(structure.height, structure.width)[::-1]


def _action(episode: Episode, index: int, step: int) -> int:
    """Return the action in a state of an episode, or the one back to the state before it."""
    return int(episode.actions[index] if step > 0 else (episode.actions[index - 1] + 2) % 4)


def _with_ends(episode: Episode, first: int, last: int) -> Labyrinth:
    start, goal = episode.states[first].agent, episode.states[last].agent
    return replace(episode.labyrinth, start=start, goal=goal)


def _parts(episode: Episode) -> list[tuple[int, int]]:
    """Return the pairs of indices of states that can be start and goal of an example."""
    pairs = list(permutations(range(len(episode) + 1), 2))
    if episode.labyrinth.door is None:
        return pairs
    return [pair for pair in pairs if pair[0] < pair[1] and _is_episode(episode, *pair)]


def _is_episode(episode: Episode, first: int, last: int) -> bool:
    """Return whether a part is a complete episode of the labyrinth with the part's ends."""
    try:
        part = replay(_with_ends(episode, first, last), episode.actions[first:last].tolist())
    except ValueError:
        return False
    return part.states == episode.states[first : last + 1]
