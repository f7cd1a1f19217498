"""The mazes of maze-dataset: its files, read without it, and its arrays of connections.

`MazeDataset.save` writes a ZANJ archive: a zip file with JSON in which large arrays and lists are
references to files beside it. The classes that it names are not looked up: connections and
solutions are read as data, and the rest is ignored. Formats: `maze_dataset/dataset/maze_dataset.py`
(`serialize`) of maze-dataset 1.4.2, https://github.com/understanding-search/maze-dataset, and
`zanj/serializing.py` of ZANJ 0.6.0, https://github.com/mivanit/ZANJ.
"""

from __future__ import annotations

import json
from itertools import accumulate, pairwise
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.language.stored_arrays import open_archive, read_array, read_member
from labyrinth_core.language.wall_grid import labyrinth_of, structure_of
from labyrinth_core.world.grid import MAX_SIDE, MIN_SIDE
from labyrinth_core.world.labyrinth import Labyrinth, Structure

_FORMAT, _REFERENCE = "__muutils_format__", "$ref"
_MALFORMED = (ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError)
"""What may be raised where JSON is used as if it were as it should be."""

Maze = tuple[NDArray[Any], NDArray[Any]]
"""The connections of a maze, shape (2, rows, columns), and its solution, shape (cells, 2)."""


def from_connections(
    connections: NDArray[Any], solution: NDArray[Any] | None = None
) -> Labyrinth | Structure:
    """Return the labyrinth of a `SolvedMaze`, a structure if no solution is given.

    Args:
        connections: Its `connection_list`, shape (2, rows, columns): whether a passage leads from
            each cell to that below, and to that at the right. The top row comes first.
        solution: Row and column of each cell of its solution, shape (cells, 2): the first is the
            start, the last is the goal.

    Raises:
        ValueError: They are no such arrays, or the labyrinth breaks a rule.
    """
    sides = connections.shape[1:]
    is_pair = connections.ndim == 3 and len(connections) == 2
    if not (is_pair and all(MIN_SIDE <= side <= MAX_SIDE for side in sides)):
        raise ValueError(
            f"its connections have the shape {connections.shape}: expected (2, rows, columns), "
            f"both from {MIN_SIDE} to {MAX_SIDE:,}"
        )
    if not np.isin(connections, (0, 1)).all():
        raise ValueError("its connections are not all 0 or 1")
    below, beside = connections != 0
    if below[-1].any() or beside[:, -1].any():
        raise ValueError("a passage leads out of the grid")
    structure = structure_of(below[:-1], beside[:, :-1])
    if solution is None:
        return structure
    if solution.ndim != 2 or solution.shape[1] != 2 or not len(solution):
        raise ValueError("its solution is no list of cells")
    ends = solution[[0, -1]]
    if not ((ends >= 0) & (ends < sides)).all():
        raise ValueError("its solution begins or ends outside the grid")
    start, goal = ends.tolist()
    return labyrinth_of(structure, tuple(start), tuple(goal))


def stored_mazes(data: bytes) -> list[Maze]:
    """Return the mazes in the bytes of a file that `MazeDataset.save` wrote.

    Raises:
        ValueError: They are no such file.
    """
    archive = open_archive(data)
    try:
        content = json.loads(read_member(archive, "__zanj__.json"))
        kind = content.get(_FORMAT)
        if kind == "MazeDataset":
            return [
                (_array(archive, maze["connection_list"]), _array(archive, maze["solution"]))
                for maze in _value(archive, content["mazes"])
            ]
        if kind in ("MazeDataset:minimal", "MazeDataset:minimal_soln_cat"):
            connections, lengths = (
                _array(archive, content[f"maze_{name}"])
                for name in ("connection_lists", "solution_lengths")
            )
            if kind == "MazeDataset:minimal":
                padded = _array(archive, content["maze_solutions"])
                solutions = [cells[:n] for cells, n in zip(padded, lengths, strict=True)]
            else:
                joined = _array(archive, content["maze_solutions_concat"])
                bounds = pairwise(accumulate(lengths.tolist(), initial=0))
                solutions = [joined[begin:end] for begin, end in bounds]
            return list(zip(connections, solutions, strict=True))
    except _MALFORMED as error:
        raise ValueError(f"no mazes that can be read: {type(error).__name__}: {error}") from error
    raise ValueError(f"expected a MazeDataset, found {str(kind)[:40]}")


def _value(archive: ZipFile, item: Any) -> Any:
    """Return what an item of the JSON stands for: a list, an array, or the item itself."""
    while isinstance(item, dict) and (_REFERENCE in item or "data" in item):
        if _REFERENCE not in item:
            item = item["data"]
            continue
        data = read_member(archive, item[_REFERENCE])
        if item[_REFERENCE].endswith(".npy"):
            return read_array(data)
        return [json.loads(line) for line in data.splitlines()]
    return item


def _array(archive: ZipFile, item: Any) -> NDArray[Any]:
    array = np.array(_value(archive, item))
    if array.dtype.kind not in "biu" or not array.ndim:
        raise ValueError(f"expected an array of whole numbers, found {array.dtype}")
    return array
