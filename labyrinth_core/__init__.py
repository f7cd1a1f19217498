"""Labyrinths for imitation learning: the world, its datasets, and policies judged in it.

    from labyrinth_core import load_transitions

    transitions = load_transitions("data/labyrinth", "5x5", split="train")

The names below are imported when they are first used, so that `import labyrinth_core` takes no time
and needs numpy alone.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labyrinth_core.data.errors import DatasetError
    from labyrinth_core.data.loader import (
        load_episodes,
        load_transitions,
        stream_episodes,
        stream_transitions,
    )
    from labyrinth_core.env import LabyrinthEnv
    from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
    from labyrinth_core.evaluation.scores import evaluate
    from labyrinth_core.language.text import dump, parse
    from labyrinth_core.pictures.renderer import render
    from labyrinth_core.world.grid import Action
    from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure, Task
    from labyrinth_core.world.random_labyrinth import sample_labyrinth
    from labyrinth_core.world.solver import optimal_actions, shortest_route

__version__ = "0.1.0"

_HOMES = {
    "Action": "world.grid",
    "DatasetError": "data.errors",
    "Labyrinth": "world.labyrinth",
    "LabyrinthEnv": "env",
    "LabyrinthError": "world.labyrinth",
    "Structure": "world.labyrinth",
    "Task": "world.labyrinth",
    "dump": "language.text",
    "evaluate": "evaluation.scores",
    "load_arrays": "evaluation.labyrinth_arrays",
    "load_episodes": "data.loader",
    "load_transitions": "data.loader",
    "optimal_actions": "world.solver",
    "parse": "language.text",
    "render": "pictures.renderer",
    "sample_labyrinth": "world.random_labyrinth",
    "shortest_route": "world.solver",
    "stream_episodes": "data.loader",
    "stream_transitions": "data.loader",
}
"""Public name -> the module that defines it, within this package."""

__all__ = [
    "Action",
    "DatasetError",
    "Labyrinth",
    "LabyrinthEnv",
    "LabyrinthError",
    "Structure",
    "Task",
    "dump",
    "evaluate",
    "load_arrays",
    "load_episodes",
    "load_transitions",
    "optimal_actions",
    "parse",
    "render",
    "sample_labyrinth",
    "shortest_route",
    "stream_episodes",
    "stream_transitions",
]


def __getattr__(name: str) -> Any:
    """Return a public name, its module imported now (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
