"""Trained policies: opening a run, a released policy, a graph or a Python object by its name.

Their networks are in `labyrinth_core.learning`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from labyrinth_core.policies.graph import SECONDS as SECONDS
    from labyrinth_core.policies.load import load_policy as load_policy
    from labyrinth_core.policies.load import read_tensors as read_tensors
    from labyrinth_core.policies.opening import PolicyNameError as PolicyNameError
    from labyrinth_core.policies.opening import files_of as files_of
    from labyrinth_core.policies.opening import imported as imported
    from labyrinth_core.policies.opening import open_policy as open_policy
    from labyrinth_core.policies.record import RunRecord as RunRecord

_HOMES = {
    "PolicyNameError": "opening",
    "RunRecord": "record",
    "SECONDS": "graph",
    "files_of": "opening",
    "imported": "opening",
    "load_policy": "load",
    "open_policy": "opening",
    "read_tensors": "load",
}
"""Name -> its module here, imported on first use: `graph_process` must import no other module."""

__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    """Import the module of an exported name, and return the object (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
