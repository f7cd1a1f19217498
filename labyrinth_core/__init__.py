"""Labyrinths for imitation learning: environments, datasets, and policy evaluation.

    from labyrinth_core import Dataset

    transitions = Dataset("data/labyrinth", "5x5")["train"].transitions()

Each public name is imported on first use, so `import labyrinth_core` is fast and needs only NumPy.
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from labyrinth_core.version import __version__ as __version__

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from labyrinth_core.benchmarks.certification import certify as certify
    from labyrinth_core.data.datasets import Dataset as Dataset
    from labyrinth_core.data.datasets import Selection as Selection
    from labyrinth_core.data.load import load_episodes as load_episodes
    from labyrinth_core.data.load import load_transitions as load_transitions
    from labyrinth_core.data.stream import stream_episodes as stream_episodes
    from labyrinth_core.data.stream import stream_transitions as stream_transitions
    from labyrinth_core.env import LabyrinthEnv as LabyrinthEnv
    from labyrinth_core.errors import DatasetError as DatasetError
    from labyrinth_core.evaluation.answers import PolicyError as PolicyError
    from labyrinth_core.evaluation.compare import compare as compare
    from labyrinth_core.evaluation.evaluate import evaluate as evaluate
    from labyrinth_core.evaluation.evaluate import memorised as memorised
    from labyrinth_core.evaluation.labyrinth_arrays import load_arrays as load_arrays
    from labyrinth_core.language.source_text import LabyrinthSyntaxError as LabyrinthSyntaxError
    from labyrinth_core.language.text import dump as dump
    from labyrinth_core.language.text import parse as parse
    from labyrinth_core.pictures.renderer import render as render
    from labyrinth_core.policies.load import load_policy as load_policy
    from labyrinth_core.policies.opening import open_policy as open_policy
    from labyrinth_core.questions.questions import question as question
    from labyrinth_core.questions.written_routes import score_answer as score_answer
    from labyrinth_core.world.labyrinth import Labyrinth as Labyrinth
    from labyrinth_core.world.rules import Action as Action
    from labyrinth_core.world.rules import LabyrinthError as LabyrinthError
    from labyrinth_core.world.rules import Task as Task
    from labyrinth_core.world.solver import optimal_actions as optimal_actions
    from labyrinth_core.world.solver import shortest_route as shortest_route
    from labyrinth_core.world.structure import Structure as Structure
    from labyrinth_core.world.tasks import sample_labyrinth as sample_labyrinth


_HOMES = {
    "Action": "world.rules",
    "Dataset": "data.datasets",
    "DatasetError": "errors",
    "Labyrinth": "world.labyrinth",
    "LabyrinthEnv": "env",
    "LabyrinthError": "world.rules",
    "LabyrinthSyntaxError": "language.source_text",
    "PolicyError": "evaluation.answers",
    "Selection": "data.datasets",
    "Structure": "world.structure",
    "Task": "world.rules",
    "certify": "benchmarks.certification",
    "compare": "evaluation.compare",
    "dump": "language.text",
    "evaluate": "evaluation.evaluate",
    "load_arrays": "evaluation.labyrinth_arrays",
    "load_episodes": "data.load",
    "load_policy": "policies.load",
    "load_transitions": "data.load",
    "memorised": "evaluation.evaluate",
    "open_policy": "policies.opening",
    "optimal_actions": "world.solver",
    "parse": "language.text",
    "question": "questions.questions",
    "render": "pictures.renderer",
    "sample_labyrinth": "world.tasks",
    "score_answer": "questions.written_routes",
    "shortest_route": "world.solver",
    "stream_episodes": "data.stream",
    "stream_transitions": "data.stream",
}
"""Public name -> the module of this package that defines it."""

__all__ = [*_HOMES]


if "IPython" in sys.modules:
    from labyrinth_core.notebooks import register

    register(sys.modules["IPython"].get_ipython())
    del register


def __getattr__(name: str) -> Any:
    """Import the module of a public name, and return the object (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
