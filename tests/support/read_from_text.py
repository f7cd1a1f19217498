"""Labyrinths read from their texts and solved, with nothing of the project's own code."""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

Cell = tuple[int, int]


@dataclass(frozen=True)
class Drawn:
    """What a text draws; rows are counted from the bottom."""

    height: int
    width: int
    passages: frozenset[frozenset[Cell]]
    tiles: tuple[tuple[str, frozenset[Cell]], ...]
    look: str
    task: tuple[str, ...]

    def cells(self, tile: str) -> frozenset[Cell]:
        return dict(self.tiles).get(tile, frozenset())

    @property
    def start(self) -> Cell:
        (cell,) = self.cells("S")
        return cell

    @property
    def goal(self) -> Cell:
        (cell,) = self.cells("E")
        return cell

    @property
    def loops(self) -> int:
        return len(self.passages) - self.height * self.width + 1

    @property
    def mirrored(self) -> Drawn:
        passages = frozenset(frozenset((c, r) for r, c in pair) for pair in self.passages)
        tiles = tuple((t, frozenset((c, r) for r, c in cells)) for t, cells in self.tiles)
        return Drawn(self.width, self.height, passages, tiles, self.look, self.task)

    def walk(self, actions: list[int]) -> Cell:
        """Return where actions lead, bumping into walls."""
        state = (self.start, False, False)
        for action in actions:
            state = self.after(state, action)
        return state[0]

    def after(self, state: tuple[Cell, bool, bool], action: int) -> tuple[Cell, bool, bool]:
        (row, column), key, door = state
        up, right = ((1, 0), (0, 1), (-1, 0), (0, -1))[action]
        there = (row + up, column + right)
        shut = there in self.cells("D") and not key
        if frozenset(((row, column), there)) not in self.passages or shut:
            return state
        return there, key or there in self.cells("K"), door or there in self.cells("D")

    def moves(self) -> int:
        """Return the number of moves of a shortest route, by breadth-first search."""
        first = (self.start, False, False)
        distance, queue = {first: 0}, deque([first])
        while queue:
            state = queue.popleft()
            if state[0] == self.goal:
                return distance[state]
            if state[0] in self.cells("I"):
                continue
            for action in range(4):
                there = self.after(state, action)
                if there not in distance:
                    distance[there] = distance[state] + 1
                    queue.append(there)
        raise AssertionError("no route")

    def is_connected(self) -> bool:
        found, stack = {(0, 0)}, [(0, 0)]
        while stack:
            cell = stack.pop()
            for pair in self.passages:
                if cell in pair:
                    (there,) = pair - {cell}
                    if there not in found:
                        found.add(there)
                        stack.append(there)
        return len(found) == self.height * self.width


def drawn(text: str) -> Drawn:
    """Return what a text draws."""
    before, _, drawing = text.partition("labyrinth:\n")
    settings = dict(re.findall(r"^(\w+): (\w+)$", before, re.MULTILINE))
    lines = drawing.splitlines()[1:-2][::-1]
    height, width = (len(lines) + 1) // 2, len(lines[0]) // 4
    passages, tiles = set(), {}
    for row in range(height):
        cells = lines[2 * row]
        for column in range(width):
            tile = cells[4 * column + 2]
            if tile != " ":
                tiles.setdefault(tile, set()).add((row, column))
            if column + 1 < width and cells[4 * column + 4] == " ":
                passages.add(frozenset(((row, column), (row, column + 1))))
            if row + 1 < height and lines[2 * row + 1][4 * column + 2] == " ":
                passages.add(frozenset(((row, column), (row + 1, column))))
    return Drawn(
        height,
        width,
        frozenset(passages),
        tuple(sorted((tile, frozenset(cells)) for tile, cells in tiles.items())),
        settings.get("look", "plain"),
        tuple(name for name, value in settings.items() if value == "True"),
    )


@dataclass(frozen=True)
class Shown:
    """A labyrinth of a split, as its rows show it."""

    number: int
    """The number in the names of its pictures."""
    text: str
    labyrinth: Drawn
    actions: list[int]
    """Of its first episode."""
    pictures: list[bytes]
    """Of its first episode."""


def shown(folder: Path, split: str) -> list[Shown]:
    """Return the labyrinths of a split, in order."""
    rows: list[dict[str, Any]] = []
    for path in sorted(folder.glob(f"{split}-*-of-*.parquet")):
        rows += pq.read_table(path).to_pylist()
    found = []
    for text, group in groupby(rows, key=lambda row: row["info"]):
        of = list(group)
        starts = [place for place, row in enumerate(of) if row["episode_starts"]]
        first = of[: [*starts, len(of)][1]]
        found.append(
            Shown(
                int(first[0]["obs"]["path"].split("-")[1]),
                text,
                drawn(text),
                [row["actions"] for row in first[:-1]],
                [row["obs"]["bytes"] for row in first],
            )
        )
    return found
