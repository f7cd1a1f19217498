"""Episodes in labyrinths that are seen only as they are visited, so that these may be large."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labyrinth_core.data.observations import ObservationSpec
from labyrinth_core.evaluation.policy import Policy
from labyrinth_core.world.dynamics import State, initial, is_terminal, transition
from labyrinth_core.world.labyrinth import Labyrinth

TOGETHER = 64
"""Pictures that a policy is shown at once."""


@dataclass(frozen=True)
class Journey:
    """A greedy episode, up to the goal, to ice, or to a state that it was in before."""

    labyrinth: Labyrinth
    states: tuple[State, ...]

    @property
    def solved(self) -> bool:
        """Whether it ends on the goal."""
        return self.states[-1].agent == self.labyrinth.goal


def travel(policy: Policy, labyrinths: Sequence[Labyrinth], image_size: int) -> list[Journey]:
    """Return one greedy episode a labyrinth.

    A policy without memory that comes back to a state never reaches the goal.

    Args:
        policy: Is shown each state that is visited once.
        labyrinths: Of one size.
        image_size: Pixels on each side of the pictures.
    """
    spec = ObservationSpec("image", image_size, draw=True)
    ways = [[initial(labyrinth)] for labyrinth in labyrinths]
    travelling = list(range(len(ways)))
    while travelling:
        for begin in range(0, len(travelling), TOGETHER):
            some = travelling[begin : begin + TOGETHER]
            pictures = [spec.look(labyrinths[each], [ways[each][-1]])[0] for each in some]
            actions = policy.logits(np.stack(pictures)).argmax(axis=1)
            for each, action in zip(some, actions.tolist(), strict=True):
                ways[each].append(transition(labyrinths[each], ways[each][-1], action))
        travelling = [each for each in travelling if not _is_over(labyrinths[each], ways[each])]
    return [Journey(*each) for each in zip(labyrinths, map(tuple, ways), strict=True)]


def _is_over(labyrinth: Labyrinth, way: list[State]) -> bool:
    return is_terminal(labyrinth, way[-1]) or way[-1] in way[:-1]
