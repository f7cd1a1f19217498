"""The stage `train`: its options, the training loop, checkpoints and records of runs.

An interrupted run goes on from its checkpoint, with the same weights in the end.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from pipeline.training.finished import require_run as require_run
    from pipeline.training.finished import show as show

_HOMES = {"require_run": "finished", "show": "finished"}
"""Name -> its module here, which needs PyTorch."""

__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    """Import the module of an exported name, and return the object (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
