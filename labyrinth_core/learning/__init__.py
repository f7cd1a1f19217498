"""What learns: networks, methods, and the base classes and steps that a method is made of.

A user's own method imports from here; the methods of this project are in `methods`.
"""

from typing import TYPE_CHECKING

from labyrinth_core.doors import door
from labyrinth_core.learning.spec import NetworkSpec as NetworkSpec
from labyrinth_core.learning.spec import PolicySpec as PolicySpec

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from labyrinth_core.learning.learner import BaseSettings as BaseSettings
    from labyrinth_core.learning.learner import Learner as Learner
    from labyrinth_core.learning.learner import setting as setting
    from labyrinth_core.learning.networks.acting import TrainedPolicy as TrainedPolicy
    from labyrinth_core.learning.networks.acting import outputs_of as outputs_of
    from labyrinth_core.learning.problem import Observations as Observations
    from labyrinth_core.learning.problem import Problem as Problem
    from labyrinth_core.learning.problem import Rollout as Rollout
    from labyrinth_core.learning.problem import Steps as Steps
    from labyrinth_core.learning.problem import roll_out as roll_out
else:  # They need PyTorch.
    __getattr__, __dir__ = door(
        __name__,
        {
            "learner": ("BaseSettings", "Learner", "setting"),
            "networks.acting": ("TrainedPolicy", "outputs_of"),
            "problem": ("Observations", "Problem", "Rollout", "Steps", "roll_out"),
        },
    )
