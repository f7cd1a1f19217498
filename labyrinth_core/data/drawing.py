"""Draw the labyrinths of a dataset and their demonstrations, each a function of config and number.

The build makes its rows from these functions. So any process can draw what a dataset with another
seed would hold, without building it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import count, islice
from typing import ClassVar

import numpy as np

from labyrinth_core.data.dataset_config import SPLITS, DatasetConfig
from labyrinth_core.world import Episode, Labyrinth, LabyrinthError, Placer, Solver, Structure

_PLACING, _ACTING, _DRAWING = 0, 1, 2
"""The purposes of a random generator: two for a structure, the last for a chunk of candidates."""


@dataclass(frozen=True)
class Drawing:
    """The random choices of a dataset, which follow from its config."""

    config: DatasetConfig

    CELLS_PER_CHUNK: ClassVar = 1_638_400, 204_800
    """The cells of all candidates in the first chunk and in any other: 65,536 and 8,192 at 5x5."""
    PATIENCE: ClassVar = 300_000
    """The number of candidates without success after which the sampler gives up."""

    def rng(self, split: str, structure: Structure) -> np.random.Generator:
        """Return the generator that places start, goal and tiles of a structure in a split."""
        return self._rng(split, structure, _PLACING)

    def acting_rng(self, split: str, structure: Structure) -> np.random.Generator:
        """Return the generator for acting in the labyrinth of a structure in a split."""
        return self._rng(split, structure, _ACTING)

    def _rng(self, split: str, structure: Structure, purpose: int) -> np.random.Generator:
        """Return a generator for one structure, split and purpose, independent of all others."""
        key = (SPLITS[split].number, int(structure.structure_id, 16), purpose)
        return np.random.default_rng(np.random.SeedSequence(self.config.seed, spawn_key=key))

    def labyrinth(self, split: str, structure: Structure) -> Labyrinth:
        """Return the labyrinth of a structure in a split without a parent.

        Raises:
            LabyrinthError: The structure cannot hold the task.
        """
        return _labyrinth(self, split, structure)

    def holds_task(self, split: str, structure: Structure) -> bool:
        """Return whether a structure can hold the task, also with another start and goal.

        Train, validation and test have the same requirement, so that they have the same
        distribution.
        """
        rules = self.config.task.rules
        if not rules.tiles:
            return True
        if rules.needs_loops and not structure.loops:
            return False
        try:
            labyrinth = self.labyrinth(split, structure)
            Placer(self.rng("s0", structure)).other_start(labyrinth)
            Placer(self.rng("s0_and_g", structure)).other_ends(labyrinth)
        except LabyrinthError:
            return False
        return True

    def candidates(
        self, number: int = 0, only: str | None = None
    ) -> Iterator[tuple[Structure, str | None]]:
        """Yield the random structures of a chunk of the dataset, then others without end.

        Each comes with its split: train, validation or test; None if no split can use it, or if it
        repeats one before it.

        Args:
            number: The number of the chunk. The first chunk suffices for most datasets.
            only: The only split for which it matters whether it can use a structure with its task,
                and with any start and goal, which takes time; None for all.
        """
        key = (number, _DRAWING) if number else ()
        structures = Structure.sample(
            self.config.height,
            self.config.width,
            np.random.default_rng(np.random.SeedSequence(self.config.seed, spawn_key=key)),
            algorithm=self.config.sampler,
            open_walls=self.config.open_walls,
        )
        seen: set[str] = set()
        for structure in structures:
            split = None
            if structure.structure_id not in seen:
                seen.add(structure.structure_id)
                split = structure.split(self.config.buckets)
                if only in (None, split):
                    if self.config.goals == "varied":
                        split = self.config.bucket_of(structure)
                    if split is not None and not self.holds_task(split, structure):
                        split = None
            yield structure, split

    def labyrinths(self, split: str) -> Iterator[Labyrinth]:
        """Yield the labyrinths of a split in the dataset's order, and go on beyond its length.

        Their structures are distinct. The iterator ends when `PATIENCE` candidates in a row bring
        no new one. `splits.min_walls` is not enforced: it changes validation and test, but not
        train.

        Args:
            split: train, validation or test.
        """
        config = self.config
        sizes = [max(1, cells // (config.height * config.width)) for cells in self.CELLS_PER_CHUNK]
        seen: set[str] = set()
        failed = 0
        for number in count():
            for structure, own_split in islice(self.candidates(number, split), sizes[number > 0]):
                failed += 1
                if failed > self.PATIENCE:
                    return
                if own_split == split and structure.structure_id not in seen:
                    seen.add(structure.structure_id)
                    failed = 0
                    yield self.labyrinth(split, structure)

    def sample_test(self, rng: np.random.Generator) -> Iterator[Labyrinth]:
        """Yield random labyrinths from the distribution of a dataset's `test`, without end.

        Each is drawn independently of the others and of the dataset: labyrinths of its `test` may
        occur, those of train and validation never do. `splits.min_walls` is not enforced.

        Raises:
            LabyrinthError: None of 10,000 structures in a row can hold the task.
        """
        config = self.config
        structures = Structure.sample(
            config.height,
            config.width,
            rng,
            algorithm=config.sampler,
            open_walls=config.open_walls,
        )
        ends = None if config.goals == "varied" else (0, config.height * config.width - 1)
        return Placer(rng).labyrinths(
            structures, config.task, ends, lambda structure: config.bucket_of(structure) == "test"
        )

    def episodes(self, split: str, labyrinth: Labyrinth) -> list[Episode]:
        """Return the episodes of a labyrinth, in order; the config selects the routes.

        Args:
            split: The split of the labyrinth; in `random` a random policy acts instead.
            labyrinth: The labyrinth to solve.
        """
        return self.episodes_by(split, Solver(labyrinth))

    def episodes_by(self, split: str, solver: Solver) -> list[Episode]:
        """Return the `episodes` of the labyrinth of a solver, which the caller uses further."""
        config, kind, labyrinth = self.config, SPLITS[split], solver.labyrinth
        # A shift that changes only pictures uses the randomness of its parent.
        drawn_for = kind.parent if kind.is_redrawn and kind.parent else split
        make_rng = partial(self.acting_rng, drawn_for, labyrinth.structure)
        if split == "random":
            return list(_random_episodes(labyrinth, make_rng(), config.random_steps))
        if config.noise:
            return [labyrinth.replay(solver.erring_route(config.noise, make_rng()))]
        if config.solutions == "shortest":
            return [labyrinth.replay(solver.shortest_route(make_rng))]
        every = solver.simple_routes if config.solutions == "all" else solver.shortest_routes
        return [labyrinth.replay(route) for route in every(config.solutions_limit)]


@lru_cache(maxsize=1)  # A structure is first asked whether it holds the task, then for all of it.
def _labyrinth(drawing: Drawing, split: str, structure: Structure) -> Labyrinth:
    config = drawing.config
    if config.goals == "varied":
        return Placer(drawing.rng(split, structure)).any_ends(structure, config.task)
    start, goal = structure.default_ends
    if not config.task.rules.tiles:  # Nothing is drawn.
        return Labyrinth(structure, start, goal, config.task)
    return Placer(drawing.rng(split, structure)).place(structure, start, goal, config.task)


def _random_episodes(
    labyrinth: Labyrinth, rng: np.random.Generator, steps: int
) -> Iterator[Episode]:
    """Yield episodes of a random policy with `steps` steps in total; the last one is cut off."""
    while steps:
        episode = Episode.random(labyrinth, rng, steps)
        steps -= len(episode)
        yield episode
