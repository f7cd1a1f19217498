"""What learns: networks, methods, and the base classes and steps that a method is made of.

A user's own method imports from here; the methods of this project are in `methods`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from labyrinth_core.learning.learner import BaseSettings as BaseSettings
    from labyrinth_core.learning.learner import Learner as Learner
    from labyrinth_core.learning.learner import Problem as Problem
    from labyrinth_core.learning.learner import setting as setting
    from labyrinth_core.learning.networks.acting import outputs_of as outputs_of
    from labyrinth_core.learning.observations import Observations as Observations
    from labyrinth_core.learning.steps import Rollout as Rollout
    from labyrinth_core.learning.steps import Steps as Steps
    from labyrinth_core.learning.steps import roll_out as roll_out

_HOMES = {
    "BaseSettings": "learner",
    "Learner": "learner",
    "Observations": "observations",
    "Problem": "learner",
    "Rollout": "steps",
    "Steps": "steps",
    "outputs_of": "networks.acting",
    "roll_out": "steps",
    "setting": "learner",
}
"""Name -> its module here, imported on first use: most need PyTorch, specifications do not."""

__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    """Import the module of an exported name, and return the object (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
