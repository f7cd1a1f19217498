"""The rules for the labyrinths of each split, and for the routes through them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.world.grid import manhattan
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError
from labyrinth_core.world.solver import distances, erring_route
from labyrinth_core.world.tasks import tiles_matter
from pipeline.generation.buckets import bucket_of
from pipeline.generation.solve import acting_rng, all_routes
from pipeline.generation.variants import first_start_and_goal


def labyrinth_problems(config: DatasetConfig, split: str, labyrinth: Labyrinth) -> Iterator[str]:
    """Yield the rules of a split that a labyrinth breaks."""
    structure = labyrinth.structure
    if not structure.is_connected:
        yield "not every cell can be reached"
    if not tiles_matter(labyrinth):
        yield "the tiles of the task make no difference"
    kind = SPLITS[split]
    bucket = bucket_of(config, structure)
    if bucket != kind.bucket:
        yield f"the structure belongs to {bucket or 'no split'}"
    if labyrinth.look is not kind.look:
        yield f"it is to be drawn {labyrinth.look}, not {kind.look}"
    yield from _end_problems(config, split, labyrinth)


def _end_problems(config: DatasetConfig, split: str, labyrinth: Labyrinth) -> Iterator[str]:
    """Yield what is wrong with the start and the goal of a labyrinth."""
    kind, varied = SPLITS[split], config.goals == "varied"
    if varied and kind.new_structure:
        return  # They are its parent's, which `relations` compares.
    start, goal = labyrinth.start, labyrinth.goal
    try:
        first_start, first_goal = first_start_and_goal(config, split, labyrinth.structure)
    except LabyrinthError as error:
        yield str(error)
        return
    if not (kind.new_start or kind.new_goal):
        if (start, goal) != (first_start, first_goal):
            yield f"start and goal are not {'those of this seed' if varied else 'in the corners'}"
        return
    if (start != first_start, goal != first_goal) != (kind.new_start, kind.new_goal):
        yield "start and goal are not changed as the split says"
    # An end that moves alone may have no cell to move to that is farther away.
    stays, former = (goal, first_start) if kind.new_start else (start, first_goal)
    apart = (
        manhattan(cell, stays, config.width)
        for cell in range(labyrinth.structure.cells)
        if cell not in (stays, former)
    )
    least = (config.height + config.width) // 2
    if not (kind.new_start and kind.new_goal):
        least = min(least, max(apart))
    if manhattan(start, goal, config.width) < least:
        yield f"start and goal are less than {least} moves apart"


def route_problem(
    config: DatasetConfig, split: str, labyrinth: Labyrinth, routes: list[list[int]]
) -> str | None:
    """Return what is wrong with the routes of a labyrinth's episodes, None if nothing is.

    Args:
        config: The configuration, which says which routes are wanted.
        split: The split of the labyrinth; in `random`, steps are counted instead.
        labyrinth: The labyrinth.
        routes: The actions of each episode, in order.
    """
    if split == "random":
        steps = sum(map(len, routes))
        return None if steps == config.random_steps else f"{steps} random steps"
    if config.noise:
        if routes == [erring_route(labyrinth, config.noise, acting_rng(config, split, labyrinth))]:
            return None
        return f"not the route of a demonstrator with noise {config.noise} and this seed"
    if config.solutions == "shortest":
        best = distances(labyrinth)[labyrinth.start]
        if len(routes) == 1 and len(routes[0]) == best:
            return None
        lengths = ", ".join(str(len(route)) for route in routes)
        return f"routes of {lengths} moves, instead of one of {best}"
    expected = all_routes(config, labyrinth)
    if routes == expected:
        return None
    return f"{len(routes)} routes, not the {len(expected)} that the configuration asks for"


def pieces_problem(steps: int, routes: Iterable[Iterable[Sequence[int]]]) -> str | None:
    """Return what is wrong with the lengths of the pieces of routes, None if nothing is.

    Args:
        steps: The number of steps that each piece has, but for the last one of a route.
        routes: The actions of each piece of each route, in order.
    """
    for route in routes:
        *whole, last = map(len, route)
        if last > steps or any(length != steps for length in whole):
            found = ", ".join(map(str, [*whole, last]))
            return f"a route in pieces of {found} steps, not of {steps}"
    return None
