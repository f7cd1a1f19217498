"""Trained policies: opening a run, a released policy, a graph or a Python object by its name.

Their networks are in `labyrinth_core.learning`.
"""

from labyrinth_core.policies.graph import SECONDS as SECONDS
from labyrinth_core.policies.load import RunRecord as RunRecord
from labyrinth_core.policies.load import load_policy as load_policy
from labyrinth_core.policies.load import read_tensors as read_tensors
from labyrinth_core.policies.opening import PolicyNameError as PolicyNameError
from labyrinth_core.policies.opening import files_of as files_of
from labyrinth_core.policies.opening import imported as imported
from labyrinth_core.policies.opening import open_policy as open_policy
