"""The vector form of a state, as in the authors' environment: tiles, then a grid of walls.

A labyrinth of height x width cells has a wall grid of (2 height - 1) x (2 width - 1) entries, row
0 at the bottom: cells at even rows and columns, passages between them, and the points where four
cells meet at odd rows and columns. The outer walls are left out.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world import Labyrinth, Labyrinths, State, Structures, Task, seen_together

OPEN, WALL, ICE = 0, 1, 2
"""The entries of the wall grid; what the agent does not see is encoded as a wall.

Ice is the first of its task's `grounds`; further ones would be 3, 4 and so on."""
GONE = -1
"""The position of a key that was picked up, or of a door that was opened."""

VectorArray = NDArray[np.int32]


def grid_indices(height: int, width: int) -> VectorArray:
    """Return the index of each cell in the flattened wall grid, shape (cells,)."""
    grid = np.arange((2 * height - 1) * (2 * width - 1), dtype=np.int32)
    return grid.reshape(2 * height - 1, 2 * width - 1)[::2, ::2].flatten()


class VectorLayout(NamedTuple):
    """Where the vectors of labyrinths of one size and task say what."""

    height: int
    width: int
    task: Task

    @property
    def length(self) -> int:
        """The number of entries of a vector."""
        return self.task.rules.positions + (2 * self.height - 1) * (2 * self.width - 1)

    @property
    def cells(self) -> VectorArray:
        """The index of each cell in the flattened wall grid, as in `grid_indices`."""
        return grid_indices(self.height, self.width)

    def bounds(self) -> tuple[VectorArray, VectorArray]:
        """Return the least and the greatest value of each entry."""
        tiles = self.task.rules.positions
        high = np.full(self.length, WALL + len(self.task.rules.grounds), np.int32)
        high[:tiles] = self.length - tiles - 1
        low = np.zeros_like(high)
        low[3:tiles] = GONE
        return low, high

    def walls(self, vectors: VectorArray) -> NDArray[np.bool_]:
        """Return which entries of the wall grids of N vectors are walls, shape (N, entries)."""
        walls: NDArray[np.bool_] = vectors[:, self.task.rules.positions :] == WALL
        return walls

    def initial(self, labyrinth: Labyrinth) -> VectorArray:
        """Return the vector of a labyrinth's initial state with nothing hidden; read-only."""
        return initial_vector(labyrinth)

    def initial_of(self, structures: Structures, ends: tuple[int, int]) -> VectorArray:
        """Return these vectors of n labyrinths without tiles, shape (n, length).

        Args:
            structures: Their structures.
            ends: The start and the goal of all of them.
        """
        return initial_vectors(structures, np.tile(ends, (len(structures), 1)))

    def show(
        self,
        vectors: VectorArray,
        states: NDArray[np.int64],
        visible: NDArray[np.bool_] | None,
    ) -> None:
        """Turn vectors of initial states into vectors of other states, in place.

        Args:
            vectors: The vector of each labyrinth's initial state, shape (N, length).
            states: The index of each state, shape (N,).
            visible: Which cells are visible, shape (N, height, width); None for all.
        """
        phase, cells = np.divmod(states, self.height * self.width)
        vectors[:, 0] = self.cells[cells]
        if self.task.rules.phases > 1:
            vectors[:, 3][phase >= 1] = GONE
            vectors[:, 4][phase == 2] = GONE
        if visible is not None:
            grids = vectors[:, self.task.rules.positions :]
            # A view: splitting an axis copies nothing.
            hide(grids.reshape(len(vectors), 2 * self.height - 1, 2 * self.width - 1), visible)
            for tile in (1, 2):
                np.put_along_axis(grids, vectors[:, tile, None], OPEN, axis=1)


def hide(grids: VectorArray, visible: NDArray[np.bool_]) -> None:
    """Turn hidden cells, and the passages between two of them, into walls, in place.

    Args:
        grids: Wall grids, shape (..., 2 height - 1, 2 width - 1).
        visible: Whether each cell is visible, shape (..., height, width).
    """
    grids[..., ::2, ::2][~visible] = WALL
    grids[..., 1::2, ::2][~(visible[..., :-1, :] | visible[..., 1:, :])] = WALL
    grids[..., ::2, 1::2][~(visible[..., :, :-1] | visible[..., :, 1:])] = WALL


# Without the cache, vectors are made 0.75 times as fast, pictures drawn 0.6 to 0.9 times as fast.
@lru_cache(maxsize=1024)
def initial_vector(labyrinth: Labyrinth) -> VectorArray:
    """Return the vector of the initial state with nothing hidden; cached, so read-only."""
    one = Labyrinths.of([labyrinth])
    vector: VectorArray = initial_vectors(one.structures, one.tiles, one.ground)[0]
    vector.setflags(write=False)
    return vector


def initial_vectors(
    structures: Structures, tiles: NDArray[np.int64], ground: NDArray[np.uint8] | None = None
) -> VectorArray:
    """Return the `initial_vector` of n labyrinths.

    Args:
        structures: Their structures.
        tiles: The cells of start and goal, then of key and door if any, shape (n, 2) or (n, 4).
        ground: What each cell shows, as in `batch.Labyrinths`, shape (n, cells); None for floors.

    Returns:
        Shape (n, length of the vector).
    """
    count, height, width = len(structures), structures.height, structures.width
    first = tiles.shape[1] + 1
    vectors: VectorArray = np.full(
        (count, first + (2 * height - 1) * (2 * width - 1)), WALL, np.int32
    )
    vectors[:, 1:first] = grid_indices(height, width)[tiles]
    vectors[:, 0] = vectors[:, 1]
    grids = vectors[:, first:].reshape(count, 2 * height - 1, 2 * width - 1)
    up, right = (
        passages.reshape(count, height, width) for passages in (structures.up, structures.right)
    )
    grids[:, ::2, ::2] = OPEN
    if ground is not None:
        covered = ground.reshape(up.shape) > 0
        grids[:, ::2, ::2][covered] = ground[ground > 0] + WALL
    grids[:, 1::2, ::2][up[:, :-1]] = OPEN
    grids[:, ::2, 1::2][right[:, :, :-1]] = OPEN
    return vectors


def vector_observation(labyrinth: Labyrinth, state: State) -> VectorArray:
    """Return the agent's observation of a state, as a new vector.

    Returns:
        Shape (tiles + (2 height - 1) * (2 width - 1),), dtype int32. First come the positions of
        agent, start and goal, then of key and door in that task, as indices into the flattened wall
        grid; -1 once the key is picked up or the door opened. The wall grid follows, row by row
        from the bottom: wall 1, open 0, ice 2. Under partial observability a cell out of sight, and
        a passage between two such cells, are 1; start and goal are always 0.
    """
    structure = labyrinth.structure
    vector: VectorArray = initial_vector(labyrinth).copy()
    row, column = divmod(state.agent, structure.width)
    vector[0] = 2 * row * (2 * structure.width - 1) + 2 * column
    if labyrinth.door is not None:
        if state.has_key:
            vector[3] = GONE
        if state.door_open:
            vector[4] = GONE
    if labyrinth.task.rules.hides:
        visible = np.zeros((structure.height, structure.width), np.bool_)
        visible.flat[list(structure.visible_from(state.agent))] = True
        grid = vector[labyrinth.task.rules.positions :]
        hide(grid.reshape(2 * structure.height - 1, 2 * structure.width - 1), visible)
        grid[vector[1:3]] = OPEN
    return vector


def vector_observations(
    labyrinths: Labyrinths, which: NDArray[np.int64], states: NDArray[np.int64]
) -> VectorArray:
    """Return `vector_observation` of N states, shape (N, length).

    Args:
        labyrinths: The labyrinths of the states.
        which: The index of each state's labyrinth, shape (N,).
        states: The index of each state, as in `Labyrinth.state_index`, shape (N,).
    """
    vectors = initial_vectors(labyrinths.structures, labyrinths.tiles, labyrinths.ground)[which]
    visible = None
    if labyrinths.task.rules.hides:
        visible = seen_by(labyrinths.take(which), states)
    height, width = labyrinths.structures.height, labyrinths.structures.width
    VectorLayout(height, width, labyrinths.task).show(vectors, states, visible)
    return vectors


def seen_by(labyrinths: Labyrinths, agents: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which cells an agent in each labyrinth sees, shape (n, height, width)."""
    structures = labyrinths.structures
    height, width = structures.height, structures.width
    first = height * width * np.arange(len(labyrinths))
    moves = (structures.moves() + first[:, None, None]).reshape(-1, 4)
    return seen_together(moves, first + agents, max(height, width)).reshape(-1, height, width)
