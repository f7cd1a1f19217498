"""The rules for the labyrinths of each split, and for the routes through them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from labyrinth_core.data.buckets import bucket_of
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.splits import SPLITS, Split
from labyrinth_core.world.grid import manhattan
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError
from labyrinth_core.world.solver import erring_route, moves_of
from labyrinth_core.world.tasks import tiles_matter
from pipeline.generation.shifts import SELECTED_SHIFTS, Measures, Train
from pipeline.generation.solve import acting_rng, all_routes
from pipeline.generation.variants import start_and_goal, twin_problem


def labyrinth_problems(
    config: DatasetConfig,
    split: str,
    labyrinth: Labyrinth,
    parent: Labyrinth | None,
    train: Train,
) -> Iterator[str]:
    """Yield the rules of a split that a labyrinth breaks.

    Args:
        config: The configuration of the dataset.
        split: The split of the labyrinth.
        labyrinth: The labyrinth.
        parent: The labyrinth that it is made from, None if it has no parent or that is not known.
        train: What train has.
    """
    kind, structure = SPLITS[split], labyrinth.structure
    if not structure.is_connected:
        yield "not every cell can be reached"
    if not tiles_matter(labyrinth):
        yield "the tiles of the task make no difference"
    bucket = bucket_of(config, structure)
    if bucket != kind.bucket:
        yield f"the structure belongs to {bucket or 'no split'}"
    if labyrinth.look is not kind.look:
        yield f"it is to be drawn {labyrinth.look}, not {kind.look}"
    if kind.parent is None:
        yield from _end_problems(config, split, labyrinth)
    elif parent is not None:
        yield from _relation_problems(config, kind, labyrinth, parent)
    if split in SELECTED_SHIFTS:
        measures = Measures(moves_of(labyrinth), structure.loops, structure.junctions)
        problem = SELECTED_SHIFTS[split].problem(measures, lambda: labyrinth, train)
        if problem is not None:
            yield problem


def _end_problems(config: DatasetConfig, split: str, labyrinth: Labyrinth) -> Iterator[str]:
    """Yield what is wrong with the ends of a labyrinth that is made from no other."""
    try:
        expected = start_and_goal(config, split, labyrinth.structure)
    except LabyrinthError as error:
        yield str(error)
        return
    if (labyrinth.start, labyrinth.goal) != expected:
        varied = config.goals == "varied"
        yield f"start and goal are not {'those of this seed' if varied else 'in the corners'}"


def _relation_problems(
    config: DatasetConfig, kind: Split, labyrinth: Labyrinth, parent: Labyrinth
) -> Iterator[str]:
    """Yield each difference between a labyrinth and its parent that the split does not allow."""
    if kind.new_structure:
        if problem := twin_problem(config, parent, labyrinth):
            yield problem
        return
    if labyrinth.structure != parent.structure:
        yield f"its structure is not that of its parent in {kind.parent}"
        return
    moved = labyrinth.start != parent.start, labyrinth.goal != parent.goal
    if moved != (kind.new_start, kind.new_goal):
        yield "start and goal are not changed as the split says"
    elif not any(moved):
        if replace(labyrinth, look=parent.look) != parent:
            yield f"more than its look differs from its parent in {kind.parent}"
    elif manhattan(labyrinth.start, labyrinth.goal, config.width) < (
        least := _least_apart(config, kind, parent)
    ):
        yield f"start and goal are less than {least} moves apart"


def _least_apart(config: DatasetConfig, kind: Split, parent: Labyrinth) -> int:
    """Return the least distance between start and goal where they are changed, without walls."""
    least = (config.height + config.width) // 2
    if kind.new_start and kind.new_goal:
        return least
    # An end that moves alone may have no cell to move to that is farther away.
    stays = parent.goal if kind.new_start else parent.start
    cells = {*range(parent.structure.cells)} - {parent.start, parent.goal}
    return min(least, max(manhattan(cell, stays, config.width) for cell in cells))


def routes_problem(
    config: DatasetConfig, split: str, labyrinth: Labyrinth, routes: list[list[int]]
) -> str | None:
    """Return what is wrong with the routes that a labyrinth has, None if nothing is.

    Args:
        config: The configuration, which says which routes are asked for.
        split: The split of the labyrinth; in `random`, steps are counted instead.
        labyrinth: The labyrinth.
        routes: The routes of its episodes, in order.
    """
    if split == "random":
        steps = sum(map(len, routes))
        return None if steps == config.random_steps else f"{steps} random steps"
    if config.noise:
        if routes != [erring_route(labyrinth, config.noise, acting_rng(config, split, labyrinth))]:
            return f"not the route of a demonstrator with noise {config.noise} and this seed"
    elif config.solutions == "shortest":
        lengths, best = [len(route) for route in routes], moves_of(labyrinth)
        if lengths != [best]:
            return f"routes of {', '.join(map(str, lengths))} moves, instead of one of {best}"
    elif routes != (expected := all_routes(config, labyrinth)):
        return f"{len(routes)} routes, not the {len(expected)} that the configuration asks for"
    return None
