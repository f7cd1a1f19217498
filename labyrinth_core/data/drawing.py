"""Draw the labyrinths of a dataset and their demonstrations, each a function of config and number.

The build makes its rows from these functions. So any process can draw what a dataset with another
seed would hold, without building it.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache, partial
from itertools import count, islice
from typing import NamedTuple

import numpy as np

from labyrinth_core.data.buckets import bucket_of
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.world.buckets import split_of
from labyrinth_core.world.dynamics import Episode, random_episode, replay
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure
from labyrinth_core.world.sampling import sample_structures
from labyrinth_core.world.solver import (
    erring_route,
    moves_and_routes,
    shortest_route,
    shortest_routes,
    simple_routes,
)
from labyrinth_core.world.tasks import (
    change_start,
    change_start_and_goal,
    default_start_and_goal,
    draw_start_and_goal,
    place,
)

CELLS_PER_CHUNK = 1_638_400, 204_800
"""The cells of all candidates in the first chunk and in any other: 65,536 and 8,192 at 5x5."""

PATIENCE = 300_000
"""The number of candidates without success after which the sampler gives up."""


PLACING, ACTING, DRAWING = 0, 1, 2
"""The purposes of a random generator: two for a structure, the last for a chunk of candidates."""


class Drawing(NamedTuple):
    """The random choices of a dataset, which follow from its config."""

    config: DatasetConfig

    def rng(self, split: str, structure: Structure, purpose: int = PLACING) -> np.random.Generator:
        """Return a generator for one structure in one split, independent of all others.

        Args:
            split: A split of the dataset.
            structure: The structure; its id is part of the key.
            purpose: `PLACING` of start, goal and tiles, or `ACTING` in the labyrinth.
        """
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
            change_start(labyrinth, self.rng("s0", structure))
            change_start_and_goal(labyrinth, self.rng("s0_and_g", structure))
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
        key = (number, DRAWING) if number else ()
        structures = sample_structures(
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
                split = split_of(structure, self.config.buckets)
                if only in (None, split):
                    if self.config.goals == "varied":
                        split = bucket_of(self.config, structure)
                    if split is not None and not self.holds_task(split, structure):
                        split = None
            yield structure, split


@lru_cache(maxsize=1)  # A structure is first asked whether it holds the task, then for all of it.
def _labyrinth(drawing: Drawing, split: str, structure: Structure) -> Labyrinth:
    config, rng = drawing.config, partial(drawing.rng, split, structure)
    if config.goals == "varied":
        return draw_start_and_goal(structure, config.task, rng())
    start, goal = default_start_and_goal(config.height, config.width)
    if not config.task.rules.tiles:  # Nothing is drawn.
        return Labyrinth(structure, start, goal, config.task)
    return place(structure, start, goal, config.task, rng())


def draw_labyrinths(config: DatasetConfig, split: str) -> Iterator[Labyrinth]:
    """Yield the labyrinths of a split in the order of the dataset, and go on beyond its length.

    Their structures are distinct. The iterator ends when `PATIENCE` candidates in a row bring no
    new one. `splits.min_walls` is not enforced: it changes validation and test, but not train.

    Args:
        config: The configuration of the dataset; another seed gives other labyrinths.
        split: train, validation or test.
    """
    drawing = Drawing(config)
    sizes = [max(1, each // (config.height * config.width)) for each in CELLS_PER_CHUNK]
    seen: set[str] = set()
    failed = 0
    for number in count():
        for structure, found in islice(drawing.candidates(number, split), sizes[number > 0]):
            failed += 1
            if failed > PATIENCE:
                return
            if found == split and structure.structure_id not in seen:
                seen.add(structure.structure_id)
                failed = 0
                yield drawing.labyrinth(split, structure)


class Solution(NamedTuple):
    """The episodes of one labyrinth, at least one."""

    episodes: list[Episode]
    shortest: tuple[int, int]
    """The number of moves of a shortest route, and the number of such routes."""

    @property
    def labyrinth(self) -> Labyrinth:
        """The labyrinth, which all episodes share."""
        return self.episodes[0].labyrinth


def solve(config: DatasetConfig, split: str, labyrinth: Labyrinth) -> Solution:
    """Return the episodes of a labyrinth, as from `episodes_in`, and its shortest routes."""
    return Solution(episodes_in(config, split, labyrinth), moves_and_routes(labyrinth))


def episodes_in(config: DatasetConfig, split: str, labyrinth: Labyrinth) -> list[Episode]:
    """Return the episodes of a labyrinth, in order.

    Args:
        config: The configuration, which selects the routes.
        split: The split of the labyrinth; in `random` a random policy acts instead.
        labyrinth: The labyrinth to solve.
    """
    kind = SPLITS[split]
    # A shift that changes only pictures uses the randomness of its parent.
    drawn_for = kind.parent if kind.is_redrawn and kind.parent else split
    make_rng = partial(Drawing(config).rng, drawn_for, labyrinth.structure, ACTING)
    if split == "random":
        return list(_random_episodes(labyrinth, make_rng(), config.random_steps))
    if config.noise:
        return [replay(labyrinth, erring_route(labyrinth, config.noise, make_rng()))]
    if config.solutions == "shortest":
        return [replay(labyrinth, shortest_route(labyrinth, make_rng))]
    enumerate_routes = simple_routes if config.solutions == "all" else shortest_routes
    routes = enumerate_routes(labyrinth, config.solutions_limit)
    return [replay(labyrinth, route) for route in routes]


def _random_episodes(
    labyrinth: Labyrinth, rng: np.random.Generator, steps: int
) -> Iterator[Episode]:
    """Yield episodes of a random policy with `steps` steps in total; the last one is cut off."""
    while steps:
        episode = random_episode(labyrinth, rng, steps)
        steps -= len(episode)
        yield episode
