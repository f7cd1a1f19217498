"""References that remember train: what a policy has to surpass to have learnt more than that.

They know the demonstrations of train and see the walls of the labyrinth that they are in. Nothing
in them generalises. They are judged by the same scores as any policy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.following import Episodes, follow
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.scores import summary_of
from labyrinth_core.world.route_memory import RouteMemory

REFERENCES = {
    "route_memory": "the shortest demonstrated way of train that is open here, if one is",
    "local_walls": "what train does most often in the same cell with the same walls around it",
}
"""Reference -> what it does."""

SIDES = 1 << np.arange(4)
"""What a wall on each of the four sides of a cell adds to the number of its surroundings."""
SURROUNDINGS = 16


@dataclass(frozen=True, eq=False)
class TrainMemory:
    """What the references remember of train."""

    routes: RouteMemory
    """The demonstrated routes."""
    actions: NDArray[np.int64]
    """The action demonstrated most often in each cell, by its surroundings, shape (cells, 16)."""

    @classmethod
    def of(cls, train: LabyrinthArrays) -> TrainMemory:
        """Return the memory of a split's demonstrations.

        In surroundings that no demonstration meets in a cell, it has the action most frequent in
        the same surroundings elsewhere; in those met nowhere, the most frequent of all.
        """
        begun = zip(train.route_starts.tolist(), train.routes, strict=True)
        routes = RouteMemory(_visited(train, start, route) for start, route in begun)
        counts = np.zeros((train.cells, SURROUNDINGS, 4), np.int64)
        np.add.at(counts, (train.position, surroundings(train)), train.demonstrated)
        for wider in (counts.sum(axis=0), counts.sum(axis=(0, 1))):
            counts = np.where(counts.any(axis=2, keepdims=True), counts, wider)
        return cls(routes, counts.argmax(axis=2))

    def figures(
        self, arrays: LabyrinthArrays
    ) -> tuple[NDArray[np.bool_], dict[str, dict[str, float]]]:
        """Return of which labyrinths a shortest route is remembered, and each reference's figures.

        The first has the shape (L,).
        """
        walked = self.walk(arrays)
        looked_up = follow(arrays, self.actions[arrays.position, surroundings(arrays)])
        told = zip(REFERENCES, (walked, looked_up), strict=True)
        known: NDArray[np.bool_] = walked.moves == arrays.distance
        return known, {name: summary_of(episodes, arrays) for name, episodes in told}

    def walk(self, arrays: LabyrinthArrays) -> Episodes:
        """Return the episodes of the agent that takes remembered ways; without one it stays."""
        ways = [self.routes.best(labyrinth) for labyrinth in arrays.labyrinths]
        moves = [arrays.step_limit if way is None else len(way) for way in ways]
        outcomes = np.array(["cut" if way is None else "solved" for way in ways])
        return Episodes(outcomes, np.array(moves, np.int64), arrays.cells)


def _visited(arrays: LabyrinthArrays, state: int, route: NDArray[np.int64]) -> list[int]:
    """Return the cells that the agent is in on a route that begins in a state."""
    states = [state]
    for action in route.tolist():
        states.append(int(arrays.next_state[states[-1], action]))
    cells: list[int] = arrays.position[states].tolist()
    return cells


def surroundings(arrays: LabyrinthArrays) -> NDArray[np.int64]:
    """Return on which sides each state has a wall or a locked door, as a number, shape (S,)."""
    blocked = arrays.next_state == np.arange(len(arrays.next_state))[:, None]
    numbers: NDArray[np.int64] = blocked @ SIDES
    return numbers
