"""The labyrinth that a structure becomes in each split."""

from __future__ import annotations

from dataclasses import replace

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure, Task
from labyrinth_core.world.tasks import (
    change_goal,
    change_start,
    change_start_and_goal,
    default_start_and_goal,
    draw_start_and_goal,
    place,
)
from pipeline.generation.one_wall import twin
from pipeline.generation.randomness import item_rng

TASKS_WITHOUT_TILES = (Task.NAVIGATION, Task.PARTIAL_OBSERVABILITY)


def labyrinth_of(config: DatasetConfig, split: str, structure: Structure) -> Labyrinth:
    """Return the labyrinth that a structure becomes in a split.

    Args:
        config: The configuration of the dataset.
        split: One of its splits.
        structure: A structure of that split; of its parent, if it has one.

    Raises:
        LabyrinthError: The structure has no such labyrinth: it cannot hold the task, or no other
            goal can, or no wall can be changed.
    """
    return labyrinth_and_parent(config, split, structure)[0]


def labyrinth_and_parent(
    config: DatasetConfig, split: str, structure: Structure
) -> tuple[Labyrinth, Labyrinth | None]:
    """Return what `labyrinth_of` returns, and the labyrinth that it is made from, if it is."""
    of = SPLITS[split].parent
    if of is None:
        return _first_labyrinth(config, split, structure), None
    parent = _first_labyrinth(config, of, structure)
    return _variant(config, split, parent), parent


def _variant(config: DatasetConfig, split: str, parent: Labyrinth) -> Labyrinth:
    kind, structure = SPLITS[split], parent.structure
    if kind.new_structure:
        return twin(config, parent)
    if kind.new_start and kind.new_goal:
        return change_start_and_goal(parent, item_rng(config, split, structure))
    if kind.new_start:
        return change_start(parent, item_rng(config, split, structure))
    if kind.new_goal:
        return change_goal(parent, item_rng(config, split, structure))
    return parent if kind.look is parent.look else replace(parent, look=kind.look)


def first_start_and_goal(
    config: DatasetConfig, split: str, structure: Structure
) -> tuple[int, int]:
    """Return start and goal of a structure in a split, or in the one that its own is made from.

    Raises:
        LabyrinthError: No start and goal of the structure can hold the task.
    """
    if config.goals == "fixed":
        return default_start_and_goal(config.height, config.width)
    labyrinth = _first_labyrinth(config, SPLITS[split].parent or split, structure)
    return labyrinth.start, labyrinth.goal


def _first_labyrinth(config: DatasetConfig, split: str, structure: Structure) -> Labyrinth:
    if config.goals == "varied":
        return draw_start_and_goal(structure, config.task, item_rng(config, split, structure))
    start, goal = default_start_and_goal(config.height, config.width)
    if config.task in TASKS_WITHOUT_TILES:  # Nothing is random about it.
        return Labyrinth(structure, start, goal, config.task)
    return place(structure, start, goal, config.task, item_rng(config, split, structure))


def holds_task(config: DatasetConfig, split: str, structure: Structure) -> bool:
    """Return whether a structure can hold the task, also with another start and goal.

    Train, validation and test have the same requirement, so that they have the same distribution.
    """
    if config.task in TASKS_WITHOUT_TILES:
        return True
    try:
        labyrinth = _first_labyrinth(config, split, structure)
        change_start(labyrinth, item_rng(config, "s0", structure))
        change_start_and_goal(labyrinth, item_rng(config, "s0_and_g", structure))
    except LabyrinthError:
        return False
    return True
