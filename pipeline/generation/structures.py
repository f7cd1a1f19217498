"""The structures of each split: unique ones from the candidates, and those that shifts select.

The candidates are random structures in chunks, each a function of its number alone. So any worker
can draw any chunk. The first chunk suffices for most datasets. It is the beginning of a single
stream from the seed: datasets that need no other chunk have the same bytes as before chunks were
introduced.

A hash of its canonical form gives each structure its split. So no structure, and no mirror image
that keeps start and goal, is in two of train, validation and test: neither within a dataset, nor
across datasets with other seeds or lengths (and the same `buckets`).

The candidates, which depend on the seed and not on the number of labyrinths, are divided among the
splits in order; so a longer dataset begins with the structures of a shorter one.

With `splits.min_walls` above 1, train stays the same. Validation and test then go through the
candidates once more, and take those that are far enough from train and from each other. So only
train, and the splits on its structures, begin with the structures of a shorter dataset.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, combinations, islice
from math import ceil

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import SPLITS, DatasetConfig, Drawing
from labyrinth_core.storage import AnyPath, File
from labyrinth_core.world import Structure
from pipeline.config import ConfigError
from pipeline.generation.labyrinths import UNFIT, Records, pack, record_type, unpack
from pipeline.generation.shifts import selected, selected_shifts
from pipeline.inspection import Neighbourhood

COUNTABLE_EDGES = 13
"""Sizes with at most this many pairs of neighbouring cells, such as 3x3, are counted in full."""


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


@dataclass(frozen=True)
class Sample:
    """The structures of a dataset."""

    structures: Mapping[str, Records]
    """Split -> its structures, `labyrinths` in each split that has its own."""
    candidates: int
    """The number of candidates up to the last one taken."""


def sample(config: DatasetConfig, candidates: Candidates | None = None) -> Sample:
    """Return `config.labyrinths` structures for each split that has its own.

    Args:
        config: The configuration of the dataset.
        candidates: Its candidates; None to draw them in this process.

    Raises:
        ConfigError: The sampler found too few structures.
    """
    candidates = candidates or Candidates(config)
    counts = dict.fromkeys(SPLITS.sampled, 0)
    if config.min_walls == 1:  # The buckets alone keep the splits apart.
        taken, last = _fill(config, candidates, counts, SPLITS.sampled)
    else:
        size = config.height, config.width
        near = {
            split: Neighbourhood(*size, config.min_walls - 1, config.labyrinths)
            for split in SPLITS.sampled
        }
        train, last_of_train = _fill(config, candidates, counts, SPLITS.sampled[:1])
        for structure in unpack(config, train["train"]):
            near["train"].add(structure)
        others, last = _fill(config, candidates, counts, SPLITS.sampled[1:], near)
        taken, last = train | others, max(last, last_of_train)
    if selected_shifts(config):
        taken |= selected(config, taken)
    return Sample(taken, last)


def _fill(
    config: DatasetConfig,
    candidates: Candidates,
    counts: dict[str, int],
    splits: Sequence[str],
    near: Mapping[str, Neighbourhood] | None = None,
) -> tuple[dict[str, Records], int]:
    """Return the structures of some splits, and the number of candidates up to the last of them.

    Args:
        config: The configuration of the dataset.
        candidates: Its candidates.
        counts: Split -> the number of structures found; this is updated.
        splits: The splits to fill.
        near: Split -> its structures, which other splits must not be near to; this is updated.
    """
    places = {split: SPLITS.sampled.index(split) for split in splits}
    taken = {split: [np.empty(0, record_type(config))] for split in splits}
    known = np.empty(0, np.int64)
    drawn = last = 0
    while any(counts[split] < config.labyrinths for split in splits):
        if drawn - last > Drawing.PATIENCE:
            raise _not_enough(config, counts)
        records = candidates.after(drawn, _expected(config, counts, splits, drawn))
        fit = np.flatnonzero(np.isin(records["split"], [*places.values()]))
        _, first = np.unique(records["id"][fit], return_index=True)
        fresh = fit[np.sort(first)]
        fresh = fresh[~np.isin(records["id"][fresh], known)]
        known = np.concatenate([known, records["id"][fresh]])
        if near:
            fresh = _far_enough(config, records, fresh, counts, near)
        for split, place in places.items():
            mine = fresh[records["split"][fresh] == place][: config.labyrinths - counts[split]]
            if len(mine):
                taken[split].append(records[mine])
                counts[split] += len(mine)
                last = max(last, drawn + int(mine[-1]) + 1)
        drawn += len(records)
    return {split: np.concatenate(parts) for split, parts in taken.items()}, last


def _expected(
    config: DatasetConfig, counts: Mapping[str, int], splits: Sequence[str], drawn: int
) -> int:
    """Return the number of further candidates that are likely to fill some splits."""
    expected = 1
    for split in splits:
        share = config.buckets[SPLITS.sampled.index(split)] / 100
        missing = config.labyrinths - counts[split]
        likely = missing * (drawn + 1) / (counts[split] + share)
        # At least `missing / share` are needed, unless the sampler gives up first.
        expected = max(expected, ceil(min(likely, max(missing / share, Drawing.PATIENCE))))
    return expected


def _far_enough(
    config: DatasetConfig,
    records: Records,
    fresh: NDArray[np.int64],
    counts: Mapping[str, int],
    near: Mapping[str, Neighbourhood],
) -> NDArray[np.int64]:
    """Return the indices of records that are not near to another split, as many as are missing.

    Args:
        config: The configuration of the dataset.
        records: The candidates.
        fresh: The indices of the new ones, in order.
        counts: Split -> the number of structures found.
        near: Split -> its structures, which other splits must not be near to; this is updated.
    """
    missing = {split: config.labyrinths - count for split, count in counts.items()}
    kept = []
    for index, structure in zip(fresh.tolist(), unpack(config, records[fresh]), strict=True):
        split = SPLITS.sampled[records["split"][index]]
        others = (near[other] for other in near if other != split)
        if missing[split] and not any(other.is_near(structure) for other in others):
            near[split].add(structure)
            missing[split] -= 1
            kept.append(index)
    return np.array(kept, np.int64)


def _not_enough(config: DatasetConfig, found: Mapping[str, int]) -> ConfigError:
    counts = ", ".join(f"{count} in {split}" for split, count in found.items())
    apart, try_ = "", "ask for fewer, or try"
    if config.min_walls > 1:
        apart = f" at least splits.min_walls={config.min_walls} walls apart"
        try_ = "ask for fewer of either, or try"
    return ConfigError(
        f"labyrinths={config.labyrinths}: of {config.name} the sampler found {counts}{apart}, and "
        f"no other in {Drawing.PATIENCE:,} draws; {try_} another open_walls or sampler"
    )


def check_capacity(config: DatasetConfig) -> None:
    """Refuse too many labyrinths before sampling, if the structures can be counted quickly.

    Raises:
        ConfigError: There are fewer structures than labyrinths.
    """
    edges = list(Structure.without_walls(config.height, config.width).passages())
    asked = f"size={config.height}x{config.width} labyrinths={config.labyrinths}"
    if len(edges) > COUNTABLE_EDGES:
        if config.labyrinths * len(SPLITS.sampled) >= 1 << len(edges):
            raise ConfigError(f"{asked}: all splits share fewer than 2**{len(edges)} structures")
        return
    rare = bool(config.task.rules.tiles)
    if not rare and config.labyrinths * 100 < 1 << len(edges):
        return
    counts, drawing = dict.fromkeys(SPLITS.sampled, 0), Drawing(config)
    subsets = chain.from_iterable(
        combinations(edges, size)
        for size in range(config.height * config.width - 1, len(edges) + 1)
    )
    for passages in subsets:
        structure = Structure.from_passages(config.height, config.width, passages)
        if structure.is_connected:
            split = config.bucket_of(structure)
            if split is not None:
                counts[split] += drawing.holds_task(split, structure)
    least = min(counts.values())
    if config.labyrinths > least:
        exist = ", ".join(f"{count} in {split}" for split, count in counts.items())
        advice = f"ask for labyrinths={least} or fewer" if least else "choose another size or task"
        raise ConfigError(f"{asked}: there can be {exist}; {advice}")
