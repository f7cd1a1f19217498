"""The candidates of a dataset: random structures in chunks, each a function of its number alone.

So any worker can draw any chunk. The first chunk suffices for most datasets. It is the beginning of
a single stream from the seed: datasets that need no other chunk have the same bytes as before
chunks were introduced.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import SPLITS, DatasetConfig, Drawing
from labyrinth_core.storage import AnyPath, File
from labyrinth_core.world import Structure

UNFIT = -1
"""In place of the split of a candidate that no split can use, or that repeats one in its chunk."""

Records = NDArray[np.void]
"""Structures of one size, shape (n,): the id of each as a number, the index of its split in
`SPLITS.sampled`, and its passages as bits."""


def record_type(config: DatasetConfig) -> np.dtype[np.void]:
    """Return the type of the items of `Records`."""
    passages = Structure.without_walls(config.height, config.width).to_bytes()
    return np.dtype([("id", "<i8"), ("split", "i1"), ("passages", f"V{len(passages)}")])


def pack(config: DatasetConfig, structures: Iterable[tuple[Structure, int]]) -> Records:
    """Return structures, each with the index of its split, as records."""
    items = [(int(each.structure_id, 16), split, each.to_bytes()) for each, split in structures]
    return np.array(items, record_type(config))


def unpack(config: DatasetConfig, records: Records) -> Iterator[Structure]:
    """Yield the structures that records hold."""
    for passages in records["passages"]:
        yield Structure.from_bytes(config.height, config.width, passages.tobytes())


@dataclass(frozen=True)
class Chunk:
    """A part of the candidates of a dataset; equal chunks give equal records."""

    config: DatasetConfig
    number: int
    size: int

    @property
    def name(self) -> str:
        """The name of the chunk's file, which depends on all options of the dataset."""
        key = json.dumps(self.config.to_json()), self.size
        return f"{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}-{self.number:05d}.chunk"

    def candidates(self) -> Iterator[tuple[Structure, int]]:
        """Yield the chunk's candidates, then others without end, each with its split's index."""
        for structure, split in Drawing(self.config).candidates(self.number):
            yield structure, UNFIT if split is None else SPLITS.sampled.index(split)

    def records(self) -> Records:
        """Draw the candidates of the chunk."""
        return pack(self.config, islice(self.candidates(), self.size))

    def read(self, folder: AnyPath) -> Records:
        """Read the candidates that `draw_chunk` wrote to a folder.

        Raises:
            FileNotFoundError: The chunk has not been drawn.
            ValueError: The file is damaged.
        """
        path = folder / self.name
        records: Records = np.frombuffer(path.read_bytes(), record_type(self.config))
        if len(records) != self.size:
            raise ValueError(f"{path} holds {len(records)} candidates, not {self.size}")
        return records


def draw_chunk(job: tuple[Chunk, AnyPath]) -> None:
    """Draw a chunk and write its file to a folder, unless it is there."""
    chunk, folder = job
    try:
        chunk.read(folder)
    except (FileNotFoundError, ValueError):
        File(folder / chunk.name).write_bytes(chunk.records().tobytes())


class Candidates:
    """The candidates of a dataset, drawn in order and on demand."""

    def __init__(
        self,
        config: DatasetConfig,
        draw: Callable[[Sequence[Chunk]], Iterable[Records]] | None = None,
        *,
        cells: tuple[int, int] = Drawing.CELLS_PER_CHUNK,
    ) -> None:
        """Prepare to draw.

        Args:
            config: The configuration of the dataset.
            draw: Returns the records of chunks, if the first one does not suffice; None to draw
                them in this process.
            cells: The cells of all candidates in the first chunk and in any other.
        """
        first, size = (max(1, each // (config.height * config.width)) for each in cells)
        self.first = Chunk(config, 0, first)
        self._later = Chunk(config, 1, size)
        self._draw = draw or partial(map, Chunk.records)
        self._begun = self.first.candidates()

    def after(self, drawn: int, count: int) -> Records:
        """Return the candidates that follow those drawn already, at least one and about `count`.

        Args:
            drawn: The number of candidates that this method has returned, 0 to begin again.
            count: The number of candidates that seems to be needed.
        """
        first, size = self.first, self._later.size
        if drawn + count <= first.size or 0 < drawn < first.size:
            if not drawn:
                self._begun = first.candidates()
            return pack(first.config, islice(self._begun, min(count, first.size - drawn)))
        begin, end = (-(-(number - first.size) // size) for number in (drawn, drawn + count))
        chunks = [replace(self._later, number=1 + number) for number in range(max(begin, 0), end)]
        return np.concatenate(list(self._draw(chunks if drawn else [first, *chunks])))
