"""Structures that are selected for a shift, alike test in all that the shift leaves free.

For each labyrinth of test in turn, the candidate is taken that is nearest to it in the measures
that are free, out of a pool that is renewed all the time. A candidate is in the bucket of test, so
nothing is trained on it, in no dataset; and no split has it yet.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.world.grid import horizontal_edges, vertical_edges
from labyrinth_core.world.labyrinth import LabyrinthError, Structure
from labyrinth_core.world.near_twins import Neighbourhood
from labyrinth_core.world.route_memory import RouteMemory
from labyrinth_core.world.sampling import ALGORITHMS, sample_structures
from labyrinth_core.world.solver import moves_of
from pipeline.config.errors import ConfigError
from pipeline.generation.buckets import bucket_of
from pipeline.generation.detours import stretched
from pipeline.generation.extremes import NO_EXTREMES, memory_problem, shift_problem
from pipeline.generation.key_set import KeySet
from pipeline.generation.solve import solve
from pipeline.generation.variants import (
    TASKS_WITHOUT_TILES,
    first_start_and_goal,
    labyrinth_of,
)


class Effort(NamedTuple):
    """How many candidates a choice is made from."""

    pool: int = 96
    """The number of candidates to choose from."""
    renewed: int = 6
    """How many of them are new for each choice."""
    patience: int = 30_000
    """The number looked at in vain after which there are taken to be no more."""


EFFORTS = {
    "longer": Effort(pool=8, renewed=1, patience=200),
    "test_new_routes": Effort(renewed=2, patience=1_000),
}
"""Shift -> the effort where it is another, as each candidate takes long to make."""

MEASURES = ("moves", "loops", "junctions")
"""What a structure is selected by: moves of a shortest route, loops, cells where ways part."""

FREE = {
    "longer": ("loops", "junctions"),
    "trees": ("moves", "junctions"),
    "open": ("moves",),
    "test_new_routes": MEASURES,
    **dict.fromkeys(ALGORITHMS, ("moves", "loops")),
}
"""Shift -> the measures of a labyrinth that it leaves free, and that follow those of test."""

_Key = tuple[int, ...]
_Candidate = tuple[_Key, Structure]


class Selection:
    """The selection of structures for the shifts of a dataset."""

    def __init__(self, config: DatasetConfig) -> None:
        self._config = config
        self._targets: list[_Key] = []
        """The measures of each labyrinth of test."""
        self._seen = KeySet()
        self._near: Neighbourhood | None = None
        if config.min_walls > 1:
            size = config.height, config.width
            self._near = Neighbourhood(*size, config.min_walls - 1, 3 * config.labyrinths)
        self._train = NO_EXTREMES
        self._routes: list[list[int]] = []
        """The agent's cells in each episode of train, if a shift needs them."""

    def notice(self, split: str, structure: Structure) -> None:
        """Take note of a structure of train, validation or test."""
        if self._near is not None:
            self._near.add(structure)
        if split == "train":
            labyrinth = labyrinth_of(self._config, split, structure)
            self._train = self._train.with_labyrinth(labyrinth)
            if "test_new_routes" in self._config.shifts:
                (solution,) = solve(self._config, split, [labyrinth])
                self._routes += (
                    [state.agent for state in episode.states] for episode in solution.episodes
                )
        elif split == "test":
            self._seen.add(int(structure.structure_id, 16))
            measures = self._measures(split, structure)
            assert measures is not None, "test is sampled from structures that hold the task"
            self._targets.append(measures)

    def of(self, split: str) -> Iterator[Structure]:
        """Yield the structures of a shift, one for each labyrinth of test.

        Raises:
            ConfigError: There are fewer.
        """
        if split == "test_new_routes":
            self._train = self._train._replace(memory=RouteMemory(self._routes))
        effort = EFFORTS.get(split, Effort())
        candidates = self._candidates(split)
        pool = list(islice(candidates, effort.pool))
        free = [MEASURES.index(name) for name in FREE[split]]
        for number, measures in enumerate(self._targets):
            target = tuple(measures[place] for place in free)
            pool += islice(candidates, effort.renewed)
            del pool[: -effort.pool]
            chosen = self._taken(pool, target, islice(candidates, effort.patience))
            if chosen is None:
                raise self._not_enough(split, number)
            # A copy without the cached properties, since a shard holds many structures.
            yield Structure(chosen.height, chosen.width, chosen.up, chosen.right)

    def _taken(
        self, pool: list[_Candidate], target: _Key, more: Iterator[_Candidate]
    ) -> Structure | None:
        """Take the candidate nearest to a target out of the pool, None if no new one is found."""
        apart = {key: _apart(key, target) for key in {key for key, _ in pool}}
        nearest_first = sorted(range(len(pool)), key=lambda place: apart[pool[place][0]])
        for tried, place in enumerate(nearest_first, start=1):
            structure = pool[place][1]
            if self._is_new(structure):
                for gone in sorted(nearest_first[:tried], reverse=True):
                    del pool[gone]
                return structure
        pool.clear()
        return next((structure for _, structure in more if self._is_new(structure)), None)

    def _in_bucket(self, structure: Structure) -> bool:
        return bucket_of(self._config, structure) == "test"

    def _is_new(self, structure: Structure) -> bool:
        if not self._in_bucket(structure):
            return False
        if self._near is not None and self._near.is_near(structure):
            return False
        return self._seen.add(int(structure.structure_id, 16))

    def _candidates(self, split: str) -> Iterator[_Candidate]:
        """Yield structures with the property of a shift, until there seem to be no more."""
        free = [MEASURES.index(name) for name in FREE[split]]
        in_vain, patience = 0, EFFORTS.get(split, Effort()).patience
        for structure in self._drawn(split):
            in_vain += 1
            if in_vain > patience:
                return
            measures = self._measures(split, structure)
            if measures is None:
                continue
            moves, loops, _ = measures
            if shift_problem(split, moves, loops, self._train) is not None:
                continue
            if split == "test_new_routes":
                labyrinth = labyrinth_of(self._config, split, structure)
                if memory_problem(labyrinth, moves, self._train) is not None:
                    continue
            in_vain = 0
            yield tuple(measures[place] for place in free), structure

    def _measures(self, split: str, structure: Structure) -> tuple[int, int, int] | None:
        """Return the measures of a structure in a split, None if it cannot hold the task."""
        if self._config.task in TASKS_WITHOUT_TILES:
            ends = first_start_and_goal(self._config, split, structure)
            moves = structure.least_moves(*ends)
        else:
            try:
                moves = moves_of(labyrinth_of(self._config, split, structure))
            except LabyrinthError:
                return None
        return moves, structure.loops, structure.junctions

    def _drawn(self, split: str) -> Iterator[Structure]:
        """Yield random structures, most of them with the property of a shift."""
        config = self._config
        key = (list(SPLITS).index(split),)
        rng = np.random.default_rng(np.random.SeedSequence(config.seed, spawn_key=key))
        sampler, open_walls = config.sampler, config.open_walls
        if split == "trees":
            open_walls = 0.0
        elif split == "open":
            open_walls = self._many_open_walls()
        elif split in ALGORITHMS:
            sampler = split
        drawn = sample_structures(
            config.height, config.width, rng, algorithm=sampler, open_walls=open_walls
        )
        if split == "test_new_routes":  # Most are refused, so that it is worth while to ask first.
            return filter(self._in_bucket, drawn)
        if split != "longer":
            return drawn

        def moves(structure: Structure) -> int:
            measures = self._measures(split, structure)
            return -1 if measures is None else measures[0]

        return stretched(drawn, moves, self._in_bucket, self._train.moves, rng)

    def _many_open_walls(self) -> float:
        """Return the probability of opening walls that gives about twice train's most loops.

        Where there are not so many walls, it gives the mean of train's most and of all.
        """
        height, width = self._config.height, self._config.width
        edges = vertical_edges(height, width) | horizontal_edges(height, width) << height * width
        walls = edges.bit_count() - height * width + 1
        return min(2 * self._train.loops + 1, (self._train.loops + walls) / 2) / walls

    def _not_enough(self, split: str, found: int) -> ConfigError:
        config = self._config
        return ConfigError(
            f"shifts: of {split} at {config.name} {found} of labyrinths={config.labyrinths} were "
            f"found, and no other after a long search; ask for fewer labyrinths, or leave {split} "
            "out"
        )


def _apart(key: _Key, target: _Key) -> int:
    return sum(abs(a - b) for a, b in zip(key, target, strict=True))
