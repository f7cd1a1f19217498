"""The rules for labyrinths and routes of each split, whatever program made them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from labyrinth_core.data import SPLITS, DatasetConfig
from labyrinth_core.world import Labyrinth, Solver
from pipeline.generation.labyrinths import NEW_STRUCTURES, Solution
from pipeline.generation.shifts import SELECTED_SHIFTS, Measures, Train


def labyrinth_problems(
    config: DatasetConfig,
    split: str,
    labyrinth: Labyrinth,
    parent: Labyrinth | None,
    train: Train,
) -> Iterator[str]:
    """Yield a message for each rule of a split that a labyrinth breaks.

    Args:
        config: The configuration of the dataset.
        split: The split of the labyrinth.
        labyrinth: The labyrinth.
        parent: The labyrinth that it is made from; None if it has no parent, or an unknown one.
        train: The properties of train.
    """
    kind, structure = SPLITS[split], labyrinth.structure
    if not structure.is_connected:
        yield "not every cell can be reached"
    solver = Solver(labyrinth)
    if not solver.tiles_matter:
        yield "the tiles of the task make no difference"
    bucket = config.bucket_of(structure)
    if bucket != kind.bucket:
        yield f"the structure belongs to {bucket or 'no split'}"
    if labyrinth.look is not kind.look:
        yield f"its look is {labyrinth.look}, not {kind.look}"
    if parent is not None:
        yield from _relation_problems(config, split, labyrinth, parent)
    if split in SELECTED_SHIFTS:
        measures = Measures(solver.moves, structure.loops, structure.junctions)
        problem = SELECTED_SHIFTS[split].problem(measures, lambda: labyrinth, train)
        if problem is not None:
            yield problem


def _relation_problems(
    config: DatasetConfig, split: str, labyrinth: Labyrinth, parent: Labyrinth
) -> Iterator[str]:
    """Yield each difference between a labyrinth and its parent that the split does not allow."""
    kind = SPLITS[split]
    if kind.new_structure:
        if problem := NEW_STRUCTURES[split].problem(config, parent, labyrinth):
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
    elif labyrinth.structure.grid_distance(labyrinth.start, labyrinth.goal) < (
        least := _least_apart(config, split, parent)
    ):
        yield f"start and goal are less than {least} moves apart"


def _least_apart(config: DatasetConfig, split: str, parent: Labyrinth) -> int:
    """Return the least distance between a changed start and goal, in moves without walls."""
    kind, least = SPLITS[split], (config.height + config.width) // 2
    if kind.new_start and kind.new_goal:
        return least
    # If only one of the two moves, no cell may be that far from the other.
    stays = parent.goal if kind.new_start else parent.start
    cells = {*range(parent.structure.cells)} - {parent.start, parent.goal}
    return min(least, max(parent.structure.grid_distance(cell, stays) for cell in cells))


def route_problems(config: DatasetConfig, split: str, solution: Solution) -> Iterator[str]:
    """Yield a message for each rule that the demonstrations of a labyrinth break.

    Each route must end at the goal, and be as short as possible unless `solutions` is `all`. These
    rules do not apply to a random policy or a demonstrator with noise.
    """
    if split == "random" or config.noise:
        return
    labyrinth, best = solution.labyrinth, Solver(solution.labyrinth).moves
    if any(episode.states[-1].agent != labyrinth.goal for episode in solution.episodes):
        yield "an episode ends before the goal"
    lengths = {len(episode) for episode in solution.episodes}
    if config.solutions != "all" and lengths != {best}:
        yield f"routes of {', '.join(map(str, sorted(lengths)))} moves, instead of {best}"
