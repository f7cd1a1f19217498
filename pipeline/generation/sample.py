"""Unique structures for each split, and the labyrinths made of them.

The split of a structure follows from a hash of its canonical form, so that no structure and no
mirror image that keeps start and goal is ever in two of train, validation and test: neither within
a dataset, nor across datasets of other seeds or lengths (with the same `buckets`).

The candidates, which depend on the seed and not on the number of labyrinths, are divided among the
splits in order; so a longer dataset begins with the structures of a shorter one.

With `splits.min_walls` train stays as it is. Validation and test then go through the candidates
once more, and take those that are far enough from train and from each other; so only train, and the
splits on its structures, begin with the structures of a shorter dataset.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, combinations
from math import ceil

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.buckets import bucket_of
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.splits import SAMPLED_SPLITS
from labyrinth_core.world.labyrinth import Structure
from pipeline.config.errors import ConfigError
from pipeline.generation.candidates import Candidates, Records, record_type, unpack
from pipeline.generation.selection import selected
from pipeline.generation.shifts import selected_shifts
from pipeline.generation.variants import TASKS_WITHOUT_TILES, holds_task
from pipeline.inspection.near_twins import Neighbourhood

PATIENCE = 300_000
"""The number of candidates without success after which the sampler gives up."""

COUNTABLE_EDGES = 13
"""The number of pairs of neighbours up to which all structures are counted, as at 3x3."""


@dataclass(frozen=True)
class Sample:
    """The structures of a dataset."""

    structures: Mapping[str, Records]
    """Split -> its structures, `labyrinths` of each, for the splits that have their own."""
    candidates: int
    """The number of candidates up to the last one that was taken."""


def sample(
    config: DatasetConfig, candidates: Candidates | None = None, *, patience: int = PATIENCE
) -> Sample:
    """Return the structures of each split that has its own, `config.labyrinths` of each.

    Args:
        config: The configuration of the dataset.
        candidates: Its candidates; None to draw them in this process.
        patience: The number of candidates without success after which it gives up.

    Raises:
        ConfigError: There seem to be fewer.
    """
    candidates = candidates or Candidates(config)
    found = dict.fromkeys(SAMPLED_SPLITS, 0)
    if config.min_walls == 1:  # Two splits have no structure in common.
        taken, last = _fill(config, candidates, found, SAMPLED_SPLITS, patience)
    else:
        size = config.height, config.width
        near = {
            split: Neighbourhood(*size, config.min_walls - 1, config.labyrinths)
            for split in SAMPLED_SPLITS
        }
        train, last_of_train = _fill(config, candidates, found, SAMPLED_SPLITS[:1], patience)
        for structure in unpack(config, train["train"]):
            near["train"].add(structure)
        others, last = _fill(config, candidates, found, SAMPLED_SPLITS[1:], patience, near)
        taken, last = train | others, max(last, last_of_train)
    if selected_shifts(config):
        taken |= selected(config, taken)
    return Sample(taken, last)


def _fill(
    config: DatasetConfig,
    candidates: Candidates,
    found: dict[str, int],
    splits: Sequence[str],
    patience: int,
    near: Mapping[str, Neighbourhood] | None = None,
) -> tuple[dict[str, Records], int]:
    """Return the structures of some splits, and the number of candidates up to the last of them.

    Args:
        config: The configuration of the dataset.
        candidates: Its candidates.
        found: Split -> the number of structures found, which is updated.
        splits: The splits to fill.
        patience: The number of candidates without success after which it gives up.
        near: Split -> the structures too near to it for other splits, which is updated.
    """
    places = {split: SAMPLED_SPLITS.index(split) for split in splits}
    taken = {split: [np.empty(0, record_type(config))] for split in splits}
    known = np.empty(0, np.int64)
    drawn = last = 0
    while any(found[split] < config.labyrinths for split in splits):
        if drawn - last > patience:
            raise _not_enough(config, found, patience)
        records = candidates.after(drawn, _expected(config, found, splits, drawn, patience))
        fit = np.flatnonzero(np.isin(records["split"], [*places.values()]))
        _, first = np.unique(records["id"][fit], return_index=True)
        fresh = fit[np.sort(first)]
        fresh = fresh[~np.isin(records["id"][fresh], known)]
        known = np.concatenate([known, records["id"][fresh]])
        if near:
            fresh = _far_enough(config, records, fresh, found, near)
        for split, place in places.items():
            mine = fresh[records["split"][fresh] == place][: config.labyrinths - found[split]]
            if len(mine):
                taken[split].append(records[mine])
                found[split] += len(mine)
                last = max(last, drawn + int(mine[-1]) + 1)
        drawn += len(records)
    return {split: np.concatenate(parts) for split, parts in taken.items()}, last


def _expected(
    config: DatasetConfig,
    found: Mapping[str, int],
    splits: Sequence[str],
    drawn: int,
    patience: int,
) -> int:
    """Return the number of further candidates that are likely to fill some splits."""
    expected = 1
    for split in splits:
        share = config.buckets[SAMPLED_SPLITS.index(split)] / 100
        missing = config.labyrinths - found[split]
        likely = missing * (drawn + 1) / (found[split] + share)
        # At least `missing / share` are needed, unless the sampler gives up before.
        expected = max(expected, ceil(min(likely, max(missing / share, patience))))
    return expected


def _far_enough(
    config: DatasetConfig,
    records: Records,
    fresh: NDArray[np.int64],
    found: Mapping[str, int],
    near: Mapping[str, Neighbourhood],
) -> NDArray[np.int64]:
    """Return the places of records that are not too near to another split, as many as are missing.

    Args:
        config: The configuration of the dataset.
        records: The candidates.
        fresh: The places of those that are new, in order.
        found: Split -> the number of structures found.
        near: Split -> the structures too near to it for other splits, which is updated.
    """
    missing = {split: config.labyrinths - count for split, count in found.items()}
    kept = []
    for place, structure in zip(fresh.tolist(), unpack(config, records[fresh]), strict=True):
        split = SAMPLED_SPLITS[records["split"][place]]
        others = (near[other] for other in near if other != split)
        if missing[split] and not any(other.is_near(structure) for other in others):
            near[split].add(structure)
            missing[split] -= 1
            kept.append(place)
    return np.array(kept, np.int64)


def _not_enough(config: DatasetConfig, found: Mapping[str, int], patience: int) -> ConfigError:
    counts = ", ".join(f"{count} in {split}" for split, count in found.items())
    apart, try_ = "", "ask for fewer, or try"
    if config.min_walls > 1:
        apart = f" at least splits.min_walls={config.min_walls} walls apart"
        try_ = "ask for fewer of either, or try"
    return ConfigError(
        f"labyrinths={config.labyrinths}: of {config.name} the sampler found {counts}{apart}, and "
        f"no other in {patience:,} draws; {try_} another open_walls or sampler"
    )


def check_capacity(config: DatasetConfig) -> None:
    """Refuse too many labyrinths at once, where all structures can be counted quickly.

    Raises:
        ConfigError: There are fewer structures than asked for.
    """
    edges = list(Structure.without_walls(config.height, config.width).passages())
    asked = f"size={config.height}x{config.width} labyrinths={config.labyrinths}"
    if len(edges) > COUNTABLE_EDGES:
        if config.labyrinths * len(SAMPLED_SPLITS) >= 1 << len(edges):
            raise ConfigError(f"{asked}: the three splits share fewer than 2**{len(edges)}")
        return
    rare = config.task not in TASKS_WITHOUT_TILES
    if not rare and config.labyrinths * 100 < 1 << len(edges):
        return
    counts = dict.fromkeys(SAMPLED_SPLITS, 0)
    subsets = chain.from_iterable(
        combinations(edges, size)
        for size in range(config.height * config.width - 1, len(edges) + 1)
    )
    for passages in subsets:
        structure = Structure.from_passages(config.height, config.width, passages)
        if structure.is_connected:
            split = bucket_of(config, structure)
            if split is not None:
                counts[split] += holds_task(config, split, structure)
    least = min(counts.values())
    if config.labyrinths > least:
        exist = ", ".join(f"{count} in {split}" for split, count in counts.items())
        advice = f"ask for labyrinths={least} or fewer" if least else "choose another size or task"
        raise ConfigError(f"{asked}: there can be {exist}; {advice}")
