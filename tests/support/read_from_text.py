"""The labyrinths of a split, read from its rows with nothing of the project's own code."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from support.brute_force import World, drawn


@dataclass(frozen=True)
class Shown:
    """A labyrinth of a split, as its rows show it."""

    number: int
    """The number in the names of its pictures."""
    text: str
    settings: str
    """The part of the text before the drawing."""
    labyrinth: World
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
                text.partition("labyrinth:")[0],
                drawn(text),
                [row["actions"] for row in first[:-1]],
                [row["obs"]["bytes"] for row in first],
            )
        )
    return found
