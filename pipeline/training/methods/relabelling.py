"""Training examples from demonstrated episodes, as they are or relabelled.

Relabelling takes any two states of an episode as start and goal: a part of a shortest route is a
shortest route, so it demonstrates the way between its ends (hindsight: Kaelbling 1993; Andrychowicz
et al. 2017). Where every move can be undone, the reversed part is a demonstration, too. In
labyrinths with a door nothing is reversed, and a part is taken only if it is a complete episode of
the labyrinth with the new start and goal, from before the key to behind the door. An episode
without such a part is taken as it is. The picture with the new start
and goal is drawn from `info`, which adds nothing to what the demonstration's own pictures show.

With memory, under partial observability, a picture shows what a policy that remembers is shown
(`labyrinth_core.policies.remembering`) after it has walked the part up to that state.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise, permutations

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.policies.remembering import PictureMemory
from labyrinth_core.world.dynamics import State
from labyrinth_core.world.labyrinth import Labyrinth, Task
from labyrinth_core.world.rollout import Episode, replay
from pipeline.config.errors import check

NO_LABEL = -1


class ExampleSampler:
    """Draws examples from the demonstrated episodes."""

    def __init__(self, arrays: LabyrinthArrays, memory: PictureMemory | None = None) -> None:
        """Replay the episodes of `arrays`; a memory makes the pictures, if one is given."""
        self._spec, self._memory = arrays.spec, memory
        self.episodes: list[Episode] = []
        for start, route in zip(arrays.route_starts.tolist(), arrays.routes, strict=True):
            labyrinth = arrays.labyrinths[arrays.labyrinth[start]]
            self.episodes.append(replay(labyrinth, route.tolist()))
        self.parts = [_parts(episode) for episode in self.episodes]
        """Of each episode, the pairs of indices of states that can be start and goal."""

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
                action alone. Under partial observability the agent's cell alone is labelled, or
                with memory those where it has been. Labels are the actions taken with the key if
                the agent has it, else those without it.
        """
        drawn = [self.example(rng, relabel, whole) for _ in range(count)]
        views, seen_from, labels = zip(*drawn, strict=True)
        return self.look(views, seen_from), np.stack(labels)

    def look_at_all(self) -> NDArray[np.uint8]:
        """Return the picture of each state in which an episode acts, episode by episode."""
        views, seen_from = [], []
        for episode in self.episodes:
            for index, state in enumerate(episode.states[:-1]):
                views.append((episode.labyrinth, state))
                seen_from.append(_agents(episode, range(index + 1)))
        return self.look(views, seen_from)

    def look(
        self, views: Sequence[tuple[Labyrinth, State]], seen_from: Sequence[frozenset[int]]
    ) -> NDArray[np.uint8]:
        """Return pictures of states; with memory, as seen from some cells, of each a set."""
        if self._memory is None:
            return self._spec.look(views)
        self._memory.reset(len(views))
        return self._memory.add(self._spec.look(views, seen_from))

    def example(
        self, rng: np.random.Generator, relabel: bool, whole: bool
    ) -> tuple[tuple[Labyrinth, State], frozenset[int], NDArray[np.int64]]:
        """Return a drawn example: a state, the agent's cells until then, and the label."""
        number = rng.integers(len(self.episodes))
        episode, parts = self.episodes[number], self.parts[number]
        first, last, labyrinth = 0, len(episode), episode.labyrinth
        if relabel and parts:
            first, last = parts[rng.integers(len(parts))]
            labyrinth = _with_ends(episode, first, last)
        step = 1 if first < last else -1
        agent = first + step * int(rng.integers(abs(last - first)))
        state = episode.states[agent]
        visited = range(first, agent + step, step)
        seen_from = _agents(episode, visited)
        if not whole:
            return (labyrinth, state), seen_from, np.array(_action(episode, agent, step))
        structure = labyrinth.structure
        labels = np.full(structure.cells, NO_LABEL)
        known = range(first, last, step)
        if labyrinth.task is Task.PARTIAL_OBSERVABILITY:
            known = visited[-1:] if self._memory is None else visited
        for index in known:
            there = episode.states[index]
            if there[1:] == state[1:]:
                labels[there.agent] = _action(episode, index, step)
        rows = labels.reshape(structure.height, structure.width)[::-1]
        return (labyrinth, state), seen_from, rows


def require_shortest(arrays: LabyrinthArrays) -> None:
    """Raise a ConfigError if the dataset's routes are not all shortest ones.

    A part of a longer route need not be a shortest way between its ends.
    """
    longer = int(arrays.demonstrated[~arrays.optimal].sum())
    check(
        not longer,
        f"method.relabel=true: parts of routes are demonstrations only if the routes are shortest, "
        f"but {longer} of {arrays.demonstrated.sum()} demonstrated actions are not on one; give "
        "method.relabel=false",
    )


def _action(episode: Episode, index: int, step: int) -> int:
    """Return the action in a state of an episode, or the one back to the state before it."""
    return int(episode.actions[index] if step > 0 else (episode.actions[index - 1] + 2) % 4)


def _agents(episode: Episode, indices: Iterable[int]) -> frozenset[int]:
    """Return the agent's cells in some states of an episode."""
    return frozenset(episode.states[index].agent for index in indices)


def _with_ends(episode: Episode, first: int, last: int) -> Labyrinth:
    start, goal = episode.states[first].agent, episode.states[last].agent
    return replace(episode.labyrinth, start=start, goal=goal)


def _parts(episode: Episode) -> list[tuple[int, int]]:
    """Return the pairs of indices of states that can be start and goal of an example."""
    pairs = permutations(range(len(episode) + 1), 2)
    if episode.labyrinth.door is None:
        cells = [state.agent for state in episode.states]
        bumps = any(cell == after for cell, after in pairwise(cells))  # They cannot be undone.
        return [
            (first, last)
            for first, last in pairs
            if cells[first] != cells[last]
            and episode.labyrinth.ice.isdisjoint((cells[first], cells[last]))
            and not (bumps and first > last)
        ]
    return [pair for pair in pairs if pair[0] < pair[1] and _is_episode(episode, *pair)]


def _is_episode(episode: Episode, first: int, last: int) -> bool:
    """Return whether a part is a complete episode of the labyrinth with the part's ends."""
    try:
        part = replay(_with_ends(episode, first, last), episode.actions[first:last].tolist())
    except ValueError:
        return False
    return part.states == episode.states[first : last + 1]
