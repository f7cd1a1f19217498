"""Unique structures for each split, and the labyrinths made of them.

The split of a structure follows from a hash of its canonical form, so that no structure and no
mirror image that keeps start and goal is ever in two of train, validation and test: neither within
a dataset, nor across datasets of other seeds or lengths (with the same `buckets`).

One stream of structures, which depends on the seed alone, is divided among the splits; so a longer
dataset begins with the structures of a shorter one.

With `splits.min_walls` train stays as it is. Validation and test then go through the stream once
more, and take the structures that are far enough from train and from each other; so only train,
and the splits on its structures, begin with the structures of a shorter dataset.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, combinations

import numpy as np

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.splits import SAMPLED_SPLITS
from labyrinth_core.world.grid import neighbours
from labyrinth_core.world.labyrinth import Structure
from labyrinth_core.world.near_twins import Neighbourhood
from labyrinth_core.world.sampling import sample_structures
from pipeline.config.errors import ConfigError
from pipeline.generation.identity import IdSet, bucket_of
from pipeline.generation.selection import with_selected
from pipeline.generation.shifts import SELECTED_SHIFTS
from pipeline.generation.variants import TASKS_WITHOUT_TILES, holds_task

PATIENCE = 300_000
"""The number of structures drawn without success after which the sampler gives up."""

COUNTABLE_EDGES = 13
"""The number of pairs of neighbours up to which all structures are counted, as at 3x3."""


def sample(config: DatasetConfig, *, patience: int = PATIENCE) -> dict[str, list[Structure]]:
    """Return the structures of each split that has its own, `config.labyrinths` of each.

    Args:
        config: The configuration of the dataset.
        patience: The number of structures drawn without success after which it gives up.

    Raises:
        ConfigError: The sampler does not find so many.
    """
    found: dict[str, list[Structure]] = {split: [] for split in own_splits(config)}
    for split, structure in stream(config, patience):
        found[split].append(structure)
    return found


def own_splits(config: DatasetConfig) -> list[str]:
    """Return the splits that have structures of their own, in the order in which they are found."""
    return [*SAMPLED_SPLITS, *(shift for shift in config.shifts if shift in SELECTED_SHIFTS)]


def stream(config: DatasetConfig, patience: int = PATIENCE) -> Iterator[tuple[str, Structure]]:
    """Yield the structures of each split that has its own as they are found, each with its split.

    It remembers only their 63-bit ids, and what `min_walls` and shifts need. The arguments are
    those of `sample`.

    Raises:
        ConfigError: The sampler does not find `config.labyrinths` of each.
    """
    sampled = _sampled(config, patience)
    selects = own_splits(config) != [*SAMPLED_SPLITS]
    yield from with_selected(config, sampled) if selects else sampled


def _sampled(config: DatasetConfig, patience: int) -> Iterator[tuple[str, Structure]]:
    """Yield the structures of train, validation and test; see `stream`."""
    found = dict.fromkeys(SAMPLED_SPLITS, 0)
    if config.min_walls == 1:  # Two splits have no structure in common.
        yield from _fill(config, found, SAMPLED_SPLITS, patience)
        return
    near = {
        split: Neighbourhood(config.height, config.width, config.min_walls - 1, config.labyrinths)
        for split in SAMPLED_SPLITS
    }
    for split, structure in _fill(config, found, SAMPLED_SPLITS[:1], patience):
        near[split].add(structure)
        yield split, structure
    yield from _fill(config, found, SAMPLED_SPLITS[1:], patience, near)


def _fill(
    config: DatasetConfig,
    found: dict[str, int],
    splits: Sequence[str],
    patience: int,
    near: Mapping[str, Neighbourhood] | None = None,
) -> Iterator[tuple[str, Structure]]:
    """Yield the structures of some splits.

    Args:
        config: The configuration of the dataset.
        found: Split -> the number of structures found, which is updated.
        splits: The splits to fill.
        patience: The number of structures drawn without success after which it gives up.
        near: Split -> the structures too near to it for other splits, which is updated.
    """
    seen = IdSet()
    without = 0
    candidates = sample_structures(
        config.height,
        config.width,
        np.random.default_rng(np.random.SeedSequence(config.seed)),
        algorithm=config.sampler,
        open_walls=config.open_walls,
    )
    for structure in candidates:
        without += 1
        if without > patience:
            raise _not_enough(config, found, patience)
        split = bucket_of(config, structure)
        if split is None or split not in splits or found[split] == config.labyrinths:
            continue
        if not seen.add(int(structure.structure_id, 16)):
            continue
        too_near = near and any(near[other].is_near(structure) for other in near if other != split)
        if not too_near and holds_task(config, split, structure):
            without = 0
            if near:
                near[split].add(structure)
            found[split] += 1
            # A copy without the cached properties, since a shard holds many structures.
            yield split, Structure(structure.height, structure.width, structure.up, structure.right)
            if all(found[each] == config.labyrinths for each in splits):
                return


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
    cells = range(config.height * config.width)
    edges = [
        (cell, beside)
        for cell in cells
        for beside in neighbours(cell, config.height, config.width).values()
        if beside > cell
    ]
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
        combinations(edges, size) for size in range(len(cells) - 1, len(edges) + 1)
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
