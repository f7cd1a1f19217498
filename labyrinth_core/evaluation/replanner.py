"""A baseline for partial observability: an optimistic planner that replans after each step.

A shortest route may depend on what is out of sight. The planner takes every passage that it has
not seen closed for open, plans a shortest route, takes its first step, and plans again (the
free-space assumption; Koenig and Likhachev 2002, "D* Lite", whose incremental search finds the same
routes as the plain search here).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.answers import PolicyError
from labyrinth_core.evaluation.baselines import REPLANNERS
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.playing import Player
from labyrinth_core.evaluation.scores import Scores
from labyrinth_core.pictures import VectorLayout
from labyrinth_core.world import Action, Structure, Task, seen_together


class Replanner:
    """An optimistic planner under partial observability, with or without memory.

        evaluate(Replanner(5, 5), "data/labyrinth", "5x5-partial_observability")

    Without memory it knows only what it sees, and `act` alone is a policy.
    """

    observation = "vector"

    def __init__(self, height: int, width: int, *, memory: bool = True) -> None:
        self.memory = memory
        self._side = max(height, width)
        self._layout = VectorLayout(height, width, Task.PARTIAL_OBSERVABILITY)
        self._cells = self._layout.cells
        # A neighbour outside the grid is the cell itself, behind the wall at the end of the grid.
        self._neighbours = np.array(Structure.without_walls(height, width).moves)
        inside = self._neighbours != np.arange(height * width)[:, None]
        between = (self._cells[:, None] + self._cells[self._neighbours]) // 2
        self._passages = np.where(inside, between, -1)
        self.reset(0)

    def for_labyrinths(self, height: int, width: int, task: Task) -> Replanner:
        """Return the planner for labyrinths of another size.

        Raises:
            PolicyError: The task's vectors have another layout.
        """
        if task.rules.positions != Task.PARTIAL_OBSERVABILITY.rules.positions:
            raise PolicyError(f"the replanner needs vectors without key and door, not of {task}")
        return Replanner(height, width, memory=self.memory)

    def reset(self, count: int) -> None:
        """Begin `count` episodes with an empty memory."""
        self._walls = np.zeros((count, *self._passages.shape), np.bool_)

    def act(self, observations: NDArray[np.int32]) -> NDArray[np.int64]:
        """Return an action for each of B vectors, shape (B,)."""
        tiles, rows = Task.PARTIAL_OBSERVABILITY.rules.positions, np.arange(len(observations))
        agents, _, goals = np.searchsorted(self._cells, observations[:, :tiles]).T
        shown = np.pad(self._layout.walls(observations), ((0, 0), (0, 1)), constant_values=True)
        walls = self._seen_walls(shown[:, self._passages], agents)
        if self.memory:
            walls |= self._walls
            self._walls = walls
        after = self._distances(~walls, goals)[:, self._neighbours][rows, agents]
        actions: NDArray[np.int64] = np.where(walls[rows, agents], np.inf, after).argmin(axis=1)
        return actions

    def _seen_walls(self, shown: NDArray[np.bool_], agents: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which walls are seen, and are not only out of sight, shape (B, cells, 4)."""
        count, cells, _ = shown.shape
        first = cells * np.arange(count)
        moves = np.where(shown, np.arange(cells)[:, None], self._neighbours)
        moves += first[:, None, None]
        seen = seen_together(moves.reshape(-1, len(Action)), first + agents, self._side)
        visible = seen.reshape(count, cells)
        walls: NDArray[np.bool_] = shown & (visible[:, :, None] | visible[:, self._neighbours])
        return walls

    def _distances(self, open_: NDArray[np.bool_], goals: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the least number of moves from each cell to the goal, shape (B, cells)."""
        distances = np.full(open_.shape[:2], np.inf)
        distances[np.arange(len(goals)), goals] = 0
        while True:
            onward = np.where(open_, distances[:, self._neighbours], np.inf).min(axis=2) + 1
            nearer = np.minimum(distances, onward)
            if np.array_equal(nearer, distances):
                return distances
            distances = nearer


def replan(arrays: LabyrinthArrays) -> dict[str, dict[str, float]]:
    """Return the figures of the replanner with and without memory, on a split seen as vectors."""
    structure = arrays.labyrinths[0].structure
    with_memory, without = (
        Replanner(structure.height, structure.width, memory=memory) for memory in (True, False)
    )
    stepped = Player.of(with_memory).step_through(arrays, 1)
    scores = Scores.of(stepped, arrays), Player.of(without.act).score(arrays)
    return {name: each.summary() for name, each in zip(REPLANNERS, scores, strict=True)}
