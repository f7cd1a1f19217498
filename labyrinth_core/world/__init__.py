"""Grid labyrinths: their structure, tasks and dynamics; sampling and solving them.

It imports nothing of the project, and all other rooms build on it.
"""

from typing import TYPE_CHECKING

from labyrinth_core.doors import door

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from labyrinth_core.world.batch import Labyrinths as Labyrinths
    from labyrinth_core.world.batch import Structures as Structures
    from labyrinth_core.world.batch import Tables as Tables
    from labyrinth_core.world.batch import seen_together as seen_together
    from labyrinth_core.world.batch_sampling import BatchSampler as BatchSampler
    from labyrinth_core.world.labyrinth import Episode as Episode
    from labyrinth_core.world.labyrinth import Labyrinth as Labyrinth
    from labyrinth_core.world.labyrinth import Sketch as Sketch
    from labyrinth_core.world.rules import RULES as RULES
    from labyrinth_core.world.rules import SIDES as SIDES
    from labyrinth_core.world.rules import TILES as TILES
    from labyrinth_core.world.rules import Action as Action
    from labyrinth_core.world.rules import LabyrinthError as LabyrinthError
    from labyrinth_core.world.rules import Look as Look
    from labyrinth_core.world.rules import State as State
    from labyrinth_core.world.rules import Task as Task
    from labyrinth_core.world.sampling import ALGORITHMS as ALGORITHMS
    from labyrinth_core.world.sampling import default_open_walls as default_open_walls
    from labyrinth_core.world.solver import RouteMemory as RouteMemory
    from labyrinth_core.world.solver import Solver as Solver
    from labyrinth_core.world.structure import BUCKETS as BUCKETS
    from labyrinth_core.world.structure import Structure as Structure
    from labyrinth_core.world.structure import identity as identity
    from labyrinth_core.world.tasks import Placer as Placer
    from labyrinth_core.world.tasks import sample_labyrinth as sample_labyrinth
else:
    __getattr__, __dir__ = door(
        __name__,
        {
            "batch": ("Labyrinths", "Structures", "Tables", "seen_together"),
            "batch_sampling": ("BatchSampler",),
            "labyrinth": ("Episode", "Labyrinth", "Sketch"),
            "rules": (
                "Action",
                "LabyrinthError",
                "Look",
                "RULES",
                "SIDES",
                "State",
                "TILES",
                "Task",
            ),
            "sampling": ("ALGORITHMS", "default_open_walls"),
            "solver": ("RouteMemory", "Solver"),
            "structure": ("BUCKETS", "Structure", "identity"),
            "tasks": ("Placer", "sample_labyrinth"),
        },
    )
