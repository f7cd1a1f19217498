"""Policies evaluated on a dataset: played, scored, compared, and asked whether they memorise.

`Evaluation` shows any policy the labyrinths of a dataset; `Results` is what a file of results has.
"""

from typing import TYPE_CHECKING

from labyrinth_core.doors import door

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from labyrinth_core.evaluation.answers import PolicyError as PolicyError
    from labyrinth_core.evaluation.contract import check_policy as check_policy
    from labyrinth_core.evaluation.description import Description as Description
    from labyrinth_core.evaluation.description import Origin as Origin
    from labyrinth_core.evaluation.description import RunName as RunName
    from labyrinth_core.evaluation.description import TrainedRun as TrainedRun
    from labyrinth_core.evaluation.description import Training as Training
    from labyrinth_core.evaluation.evaluate import Evaluation as Evaluation
    from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays as LabyrinthArrays
    from labyrinth_core.evaluation.playing import Player as Player
    from labyrinth_core.evaluation.results import Results as Results
    from labyrinth_core.evaluation.results_form import KnownDataset as KnownDataset
else:
    __getattr__, __dir__ = door(
        __name__,
        {
            "answers": ("PolicyError",),
            "contract": ("check_policy",),
            "description": (
                "Description",
                "Origin",
                "RunName",
                "TrainedRun",
                "Training",
            ),
            "evaluate": ("Evaluation",),
            "labyrinth_arrays": ("LabyrinthArrays",),
            "playing": ("Player",),
            "results": ("Results",),
            "results_form": ("KnownDataset",),
        },
    )
