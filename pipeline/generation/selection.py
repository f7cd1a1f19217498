"""The structures of shifts that have their own, like those of test in all that the shift leaves.

For each labyrinth of test in turn, the candidate is taken that is nearest to it in the measures
that are free, out of a pool that is renewed all the time. A candidate is in the bucket of test, so
nothing is trained on it, in no dataset; and no split has it yet.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import islice
from typing import NamedTuple

import numpy as np

from labyrinth_core.data.buckets import bucket_of
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.world.labyrinth import Labyrinth, Structure
from pipeline.config.errors import ConfigError
from pipeline.generation.candidates import UNFIT, Records, pack, unpack
from pipeline.generation.shifts import (
    SELECTED_SHIFTS,
    Measures,
    Train,
    measures_of,
    selected_shifts,
    train_of,
)
from pipeline.generation.solve import solve
from pipeline.generation.variants import labyrinth_of
from pipeline.inspection.near_twins import Neighbourhood
from pipeline.machinery.console import tracked


class Candidate(NamedTuple):
    """A structure that may be selected, with those of its measures that follow test."""

    measures: tuple[int, ...]
    structure: Structure


def selected(config: DatasetConfig, sampled: Mapping[str, Records]) -> dict[str, Records]:
    """Return the structures of the shifts that select theirs.

    Args:
        config: The configuration of the dataset.
        sampled: The structures of train, validation and test.

    Raises:
        ConfigError: There are too few for a shift.
    """
    structures = unpack(config, sampled["train"])
    labyrinths = (labyrinth_of(config, "train", structure) for structure in structures)
    train = train_of(config, ((each, _routes(config, each)) for each in labyrinths))
    taken = Taken(config)
    for split, records in sampled.items():
        for structure in unpack(config, records):
            taken.add(split, structure)
    measured = (measures_of(config, "test", each) for each in unpack(config, sampled["test"]))
    targets = [measures for measures in measured if measures is not None]  # As test holds the task.

    def of(split: str) -> Iterator[tuple[Structure, int]]:
        found = ((1, each) for each in select(config, split, train, targets, taken))
        return ((each, UNFIT) for each in tracked(found, split, config.labyrinths))

    return {split: pack(config, of(split)) for split in selected_shifts(config)}


def _routes(config: DatasetConfig, labyrinth: Labyrinth) -> Iterator[list[int]]:
    """Yield the cells of each route that train demonstrates in a labyrinth."""
    for episode in solve(config, "train", labyrinth).episodes:
        yield [state.agent for state in episode.states]


class Taken:
    """The structures that shifts may not select: those that a split has, or that are near to it."""

    def __init__(self, config: DatasetConfig) -> None:
        self._config = config
        self._ids: set[int] = set()
        self._near: Neighbourhood | None = None
        if config.min_walls > 1:
            size = config.height, config.width
            self._near = Neighbourhood(*size, config.min_walls - 1, 3 * config.labyrinths)

    def add(self, split: str, structure: Structure) -> None:
        """Add a structure of train, validation or test."""
        if self._near is not None:
            self._near.add(structure)
        if split == "test":  # No shift has structures of the buckets of the others.
            self._ids.add(int(structure.structure_id, 16))

    def take(self, structure: Structure) -> bool:
        """Take a structure for a shift; return whether it was free."""
        if bucket_of(self._config, structure) != "test":
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
        train: What train has.
        targets: The measures of each labyrinth of test.
        taken: The structures that may not be selected, which is updated.

    Raises:
        ConfigError: There are fewer.
    """
    shift = SELECTED_SHIFTS[split]
    candidates = _candidates(config, split, train)
    pool = list(islice(candidates, shift.effort.pool))
    for number, measures in enumerate(targets):
        pool += islice(candidates, shift.effort.renewed)
        del pool[: -shift.effort.pool]
        chosen = _nearest(pool, _free(split, measures), taken)
        if chosen is None:
            pool.clear()
            more = (each.structure for each in islice(candidates, shift.effort.patience))
            chosen = next(filter(taken.take, more), None)
        if chosen is None:
            raise ConfigError(
                f"shifts: of {split} at {config.name} {number} of labyrinths={config.labyrinths} "
                "were found, and no other after a long search; ask for fewer labyrinths, or leave "
                f"{split} out"
            )
        yield chosen


def _nearest(pool: list[Candidate], target: tuple[int, ...], taken: Taken) -> Structure | None:
    """Take the free candidate nearest to a target out of a pool; return None if all are taken.

    Those that were nearer and are not free leave the pool as well.
    """

    def apart(measures: tuple[int, ...]) -> int:
        return sum(abs(a - b) for a, b in zip(measures, target, strict=True))

    distances = {key: apart(key) for key in {each.measures for each in pool}}
    nearest_first = sorted(range(len(pool)), key=lambda place: distances[pool[place].measures])
    for tried, place in enumerate(nearest_first, start=1):
        structure = pool[place].structure
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
        if without > shift.effort.patience:
            return
        measures = measures_of(config, split, structure)
        labyrinth = partial(labyrinth_of, config, split, structure)
        if measures is not None and shift.problem(measures, labyrinth, train) is None:
            without = 0
            yield Candidate(_free(split, measures), structure)


def _free(split: str, measures: Measures) -> tuple[int, ...]:
    return tuple(getattr(measures, name) for name in SELECTED_SHIFTS[split].free)
