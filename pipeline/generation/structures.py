"""The structures of each split: unique ones from the candidates, and those that shifts select.

A hash of its canonical form gives each structure its split. So no structure, and no mirror image
that keeps start and goal, is in two of train, validation and test: neither within a dataset, nor
across datasets with other seeds or lengths (and the same `buckets`).

The candidates, which depend on the seed and not on the number of labyrinths, are divided among the
splits in order; so a longer dataset begins with the structures of a shorter one.

With `splits.min_walls` above 1, train stays the same. Validation and test then go through the
candidates once more, and take those that are far enough from train and from each other. So only
train, and the splits on its structures, begin with the structures of a shorter dataset.

A shift that selects its own structures matches test in the measures that the shift does not change.
For each labyrinth of test in turn, it takes the candidate nearest in these measures, from a pool
that is constantly renewed. Each structure taken is in the bucket of test, so no dataset trains on
it, and no other split has it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, combinations, islice
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import SPLITS, DatasetConfig, Drawing
from labyrinth_core.world import Labyrinth, Structure
from pipeline.config import ConfigError
from pipeline.generation.candidates import UNFIT, Candidates, Records, pack, record_type, unpack
from pipeline.generation.shifts import (
    SELECTED_SHIFTS,
    Measures,
    Train,
    measures_of,
    selected_shifts,
    train_of,
)
from pipeline.inspection import Neighbourhood
from pipeline.machinery import tracked

COUNTABLE_EDGES = 13
"""Sizes with at most this many pairs of neighbouring cells, such as 3x3, are counted in full."""


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


class Candidate(NamedTuple):
    """A structure that may be selected, with the measures that are matched to test."""

    measures: tuple[int, ...]
    structure: Structure


def selected(config: DatasetConfig, sampled: Mapping[str, Records]) -> dict[str, Records]:
    """Return the structures of each shift that selects its own.

    Args:
        config: The configuration of the dataset.
        sampled: The structures of train, validation and test.

    Raises:
        ConfigError: A shift finds too few structures.
    """
    structures = unpack(config, sampled["train"])
    labyrinths = (Drawing(config).labyrinth("train", structure) for structure in structures)
    train = train_of(config, ((each, _routes(config, each)) for each in labyrinths))
    taken = Taken(config, sampled)
    measured = (measures_of(config, "test", each) for each in unpack(config, sampled["test"]))
    targets = [measures for measures in measured if measures is not None]  # Test holds the task.

    def of(split: str) -> Iterator[tuple[Structure, int]]:
        picked = ((1, each) for each in select(config, split, train, targets, taken))
        return ((each, UNFIT) for each in tracked(picked, split, config.labyrinths))

    return {split: pack(config, of(split)) for split in selected_shifts(config)}


def _routes(config: DatasetConfig, labyrinth: Labyrinth) -> Iterator[list[int]]:
    """Yield the cells of each route that train demonstrates in a labyrinth."""
    for episode in Drawing(config).episodes("train", labyrinth):
        yield [state.agent for state in episode.states]


class Taken:
    """The structures that shifts may not select: those that a split has, or that are near them."""

    def __init__(self, config: DatasetConfig, sampled: Mapping[str, Records]) -> None:
        self._config = config
        # Shifts never select from the buckets of the other splits.
        self._ids: set[int] = set(sampled["test"]["id"].tolist())
        self._near: Neighbourhood | None = None
        if config.min_walls > 1:
            size = config.height, config.width
            self._near = Neighbourhood(*size, config.min_walls - 1, 3 * config.labyrinths)
            for structure in chain.from_iterable(unpack(config, of) for of in sampled.values()):
                self._near.add(structure)

    def take(self, structure: Structure) -> bool:
        """Take a structure for a shift; return whether it was free."""
        if self._config.bucket_of(structure) != "test":
            return False
        if self._near is not None and self._near.is_near(structure):
            return False
        number = int(structure.structure_id, 16)
        is_free = number not in self._ids
        self._ids.add(number)
        return is_free


def select(
    config: DatasetConfig, split: str, train: Train, targets: Sequence[Measures], taken: Taken
) -> Iterator[Structure]:
    """Yield the structures of a shift, one for each labyrinth of test.

    Args:
        config: The configuration of the dataset.
        split: The shift.
        train: The properties of train.
        targets: The measures of each labyrinth of test.
        taken: The structures that may not be selected; this is updated.

    Raises:
        ConfigError: The search finds too few structures.
    """
    shift = SELECTED_SHIFTS[split]
    candidates = _candidates(config, split, train)
    pool = list(islice(candidates, shift.pool))
    for number, measures in enumerate(targets):
        pool += islice(candidates, shift.renewed)
        del pool[: -shift.pool]
        chosen = _nearest(pool, _free(split, measures), taken)
        if chosen is None:
            pool.clear()
            more = (each.structure for each in islice(candidates, shift.patience))
            chosen = next(filter(taken.take, more), None)
        if chosen is None:
            raise ConfigError(
                f"shifts: {number} of labyrinths={config.labyrinths} were found for {split} at "
                f"{config.name}, and no other after a long search; ask for fewer labyrinths, or "
                f"leave {split} out"
            )
        yield chosen


def _nearest(pool: list[Candidate], target: tuple[int, ...], taken: Taken) -> Structure | None:
    """Take the free candidate nearest to a target out of a pool; return None if none is free.

    Nearer candidates that are not free leave the pool as well.
    """

    def apart(measures: tuple[int, ...]) -> int:
        return sum(abs(a - b) for a, b in zip(measures, target, strict=True))

    distances = {key: apart(key) for key in {each.measures for each in pool}}
    nearest_first = sorted(range(len(pool)), key=lambda index: distances[pool[index].measures])
    for tried, index in enumerate(nearest_first, start=1):
        structure = pool[index].structure
        if taken.take(structure):
            for gone in sorted(nearest_first[:tried], reverse=True):
                del pool[gone]
            return structure
    return None


def _candidates(config: DatasetConfig, split: str, train: Train) -> Iterator[Candidate]:
    """Yield structures with the property of a shift, until there seem to be no more."""
    shift = SELECTED_SHIFTS[split]
    seed = np.random.SeedSequence(config.seed, spawn_key=(SPLITS[split].number,))
    without = 0
    for structure in shift.draw(config, split, train, np.random.default_rng(seed)):
        without += 1
        if without > shift.patience:
            return
        measures = measures_of(config, split, structure)
        labyrinth = partial(Drawing(config).labyrinth, split, structure)
        if measures is not None and shift.problem(measures, labyrinth, train) is None:
            without = 0
            yield Candidate(_free(split, measures), structure)


def _free(split: str, measures: Measures) -> tuple[int, ...]:
    return tuple(getattr(measures, name) for name in SELECTED_SHIFTS[split].free)
