"""The stage `train`: its options, the training loop, checkpoints and records of runs.

An interrupted run goes on from its checkpoint, with the same weights in the end.
"""

from typing import TYPE_CHECKING

from labyrinth_core.doors import door

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from pipeline.training.record import require_run as require_run
    from pipeline.training.record import show as show
else:
    __getattr__, __dir__ = door(__name__, {"record": ("require_run", "show")})
