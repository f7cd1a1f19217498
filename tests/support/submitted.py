"""Results for tests, as anybody would save them, and small changes to them."""

from __future__ import annotations

from typing import Any

import numpy as np

from labyrinth_core import evaluate
from labyrinth_core.evaluation.description import Description
from labyrinth_core.evaluation.following import Episodes
from labyrinth_core.evaluation.replanner import Replanner
from labyrinth_core.evaluation.results import Results
from labyrinth_core.evaluation.scores import Scores, episodes_of


def forgetful(height: int, width: int, share: float = 0.2) -> Any:
    """Return a policy that plans, but errs in a share of the states, always in the same ones."""
    planner = Replanner(height, width, memory=False)

    def act(observations):
        weights = np.arange(1, observations.shape[1] + 1) ** 2
        drawn = (observations @ weights * 2654435761) % 2**32
        return np.where(drawn < share * 2**32, drawn % 4, planner.act(observations))

    return act


def results_of(source: Any, config: str, policy: Any, **options: Any) -> Results:
    """Return what a policy that looks at vectors achieves."""
    return evaluate(policy, source, config, observation="vector", **options)


def content_of(results: Results, name: str = "mine", **about: Any) -> dict[str, Any]:
    """Return the content of the file."""
    return results.to_json(Description(name, **about))


def add_up(told: dict[str, Any], cells: int) -> None:
    """Make the figures of a split follow from its outcomes and moves, as a forger would."""
    rows = zip(told["outcomes"], told["moves"], strict=True)
    each = [episodes_of({"outcomes": row, "moves": moves}, cells) for row, moves in rows]
    outcomes, moves = (np.stack([getattr(e, name) for e in each]) for name in ("outcomes", "moves"))
    distance = np.array(told["distance"])
    scores = Scores(Episodes(outcomes, moves, cells), distance, distance, None, None)
    told |= scores.figures()
