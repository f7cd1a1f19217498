"""The Gymnasium environments: `gymnasium.make("labyrinth_core.env:Labyrinth-v0")`.

A single environment, and one of many labyrinths whose steps are look-ups in stacked tables.
"""

import gymnasium

from labyrinth_core.env.environment import LabyrinthEnv

__all__ = ["LabyrinthEnv"]

gymnasium.register(
    id="Labyrinth-v0",
    entry_point="labyrinth_core.env:LabyrinthEnv",
    vector_entry_point="labyrinth_core.env.vector_env:LabyrinthVectorEnv",
)
