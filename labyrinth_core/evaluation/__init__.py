"""Policies evaluated on a dataset: played, scored, compared, and asked whether they memorise.

`Evaluation` shows any policy the labyrinths of a dataset; `Results` is what a file of results has.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from labyrinth_core.evaluation.answers import PolicyError as PolicyError
    from labyrinth_core.evaluation.contract import check_policy as check_policy
    from labyrinth_core.evaluation.description import Description as Description
    from labyrinth_core.evaluation.description import Origin as Origin
    from labyrinth_core.evaluation.description import RunName as RunName
    from labyrinth_core.evaluation.description import TrainedRun as TrainedRun
    from labyrinth_core.evaluation.description import Training as Training
    from labyrinth_core.evaluation.evaluate import Evaluation as Evaluation
    from labyrinth_core.evaluation.known import KnownDataset as KnownDataset
    from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays as LabyrinthArrays
    from labyrinth_core.evaluation.playing import Player as Player
    from labyrinth_core.evaluation.results import Results as Results

_HOMES = {
    "Description": "description",
    "Evaluation": "evaluate",
    "KnownDataset": "known",
    "LabyrinthArrays": "labyrinth_arrays",
    "Origin": "description",
    "Player": "playing",
    "PolicyError": "answers",
    "Results": "results",
    "RunName": "description",
    "TrainedRun": "description",
    "Training": "description",
    "check_policy": "contract",
}
"""Name -> its module here, imported on first use: descriptions and errors need little."""

__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    """Import the module of an exported name, and return the object (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
