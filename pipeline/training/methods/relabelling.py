"""Examples from routes, as they are or relabelled: any two states of a route, start and goal.

A part of a shortest route is a shortest route, so it demonstrates the way between its ends
(hindsight: Kaelbling 1993; Andrychowicz et al. 2017). Where every move can be undone, so does the
part walked backwards. With a door it cannot: there nothing is reversed, and a part is taken only
if it is a whole episode of the labyrinth with its ends, the start before the key and the goal
behind the door. The picture with the new start and goal is drawn from `info`, which adds nothing
that the demonstration's own pictures do not show.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.world.labyrinth import Labyrinth, Task
from labyrinth_core.world.rollout import Episode, replay
from pipeline.training.steps import Steps

NO_LABEL = -1


class Examples(NamedTuple):
    """N pictures, and what is demonstrated in them."""

    pictures: NDArray[np.uint8]
    """Shape (N, size, size, 3)."""
    labels: NDArray[np.int64]
    """Actions, shape (N,); or of every cell, shape (N, height, width), rows from the top,
    `NO_LABEL` where nothing is demonstrated."""


class Routes:
    """The demonstrated routes, to draw examples from."""

    def __init__(self, worlds: LabyrinthArrays, demonstrations: Steps) -> None:
        """Replay the routes.

        Args:
            worlds: Their labyrinths.
            demonstrations: The routes of `worlds`, one after the other.
        """
        self._worlds = worlds
        firsts = np.cumsum([0, *map(len, worlds.routes)])[:-1]
        places = worlds.labyrinth[demonstrations.states[firsts]].tolist()
        self._episodes = [
            replay(worlds.labyrinths[place], route.tolist())
            for place, route in zip(places, worlds.routes, strict=True)
        ]
        self._parts = [_parts(episode) for episode in self._episodes]

    def draw(self, count: int, rng: np.random.Generator, *, relabel: bool, whole: bool) -> Examples:
        """Return examples: a route, a part of it, and a place of the agent on it, at random.

        Args:
            count: How many, at least one.
            rng: Draws them.
            relabel: Whether any two states of a route are start and goal, or its ends only.
            whole: Whether all cells of the part are labelled, or the agent's action is the label.
                Cells are so only as far as they are seen, and in the agent's phase: with or
                without the key.
        """
        drawn = [self._example(rng, relabel, whole) for _ in range(count)]
        pictures, labels = zip(*drawn, strict=True)
        return Examples(np.stack(pictures), np.stack(labels))

    def _example(
        self, rng: np.random.Generator, relabel: bool, whole: bool
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        number = rng.integers(len(self._episodes))
        episode, parts = self._episodes[number], self._parts[number]
        first, last = parts[rng.integers(len(parts))] if relabel else (0, len(episode))
        step = 1 if first < last else -1
        agent = first + step * int(rng.integers(abs(last - first)))
        state, labyrinth = episode.states[agent], _with_ends(episode, first, last)
        picture: NDArray[np.uint8] = self._worlds.spec.look(labyrinth, [state])[0]
        if not whole:
            return picture, np.array(_action(episode, agent, step))
        structure = labyrinth.structure
        labels = np.full(structure.cells, NO_LABEL)
        hidden = labyrinth.task is Task.PARTIAL_OBSERVABILITY
        for place in [agent] if hidden else range(first, last, step):
            there = episode.states[place]
            if there[1:] == state[1:]:
                labels[there.agent] = _action(episode, place, step)
        return picture, labels.reshape(structure.height, structure.width)[::-1]


def _action(episode: Episode, place: int, step: int) -> int:
    """Return the action at a place of a route, or the one that leads back from it."""
    return int(episode.actions[place] if step > 0 else (episode.actions[place - 1] + 2) % 4)


def _with_ends(episode: Episode, first: int, last: int) -> Labyrinth:
    start, goal = episode.states[first].agent, episode.states[last].agent
    return replace(episode.labyrinth, start=start, goal=goal)


def _parts(episode: Episode) -> list[tuple[int, int]]:
    """Return the places on a route that are start and goal of examples, in this order."""
    places = range(len(episode) + 1)
    pairs = [(first, last) for first in places for last in places if first != last]
    if episode.labyrinth.door is None:
        return pairs
    return [pair for pair in pairs if pair[0] < pair[1] and _is_episode(episode, *pair)]


def _is_episode(episode: Episode, first: int, last: int) -> bool:
    """Return whether a part of a route is an episode of the labyrinth with its ends."""
    try:
        part = replay(_with_ends(episode, first, last), episode.actions[first:last].tolist())
    except ValueError:
        return False
    return part.states == episode.states[first : last + 1]
