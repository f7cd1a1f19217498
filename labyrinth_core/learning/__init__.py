"""What a method of learning is made of: its base classes, and the steps that it learns from.

A user's own method imports from here; the methods of this project are in `pipeline.training`.
"""

from labyrinth_core.learning.learner import BaseSettings as BaseSettings
from labyrinth_core.learning.learner import Learner as Learner
from labyrinth_core.learning.learner import Problem as Problem
from labyrinth_core.learning.learner import setting as setting
from labyrinth_core.learning.observations import Observations as Observations
from labyrinth_core.learning.steps import Rollout as Rollout
from labyrinth_core.learning.steps import Steps as Steps
from labyrinth_core.learning.steps import roll_out as roll_out
from labyrinth_core.policies.networks.acting import outputs_of as outputs_of
