"""Episodes of a policy step by step, to be looked at; `stepping` has those that are judged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labyrinth_core.data.observations import ObservationSpec
from labyrinth_core.evaluation.answers import asked, decide
from labyrinth_core.evaluation.stepping import Player
from labyrinth_core.world.dynamics import initial, is_terminal, transition
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.rollout import Episode, replay


def attempts(
    player: Player, labyrinths: Sequence[Labyrinth], spec: ObservationSpec
) -> list[Episode]:
    """Return an episode in each of some labyrinths, cut after as many steps as there are cells.

    Args:
        player: The policy.
        labyrinths: Labyrinths of one size and task.
        spec: What the policy is shown of their states.

    Raises:
        PolicyError: The policy raises an error, or answers with anything but actions.
    """
    states = [initial(labyrinth) for labyrinth in labyrinths]
    taken: list[list[int]] = [[] for _ in labyrinths]
    running = np.arange(len(labyrinths))
    if player.reset is not None:
        asked(player.reset, len(labyrinths))
    for _ in range(labyrinths[0].structure.cells):
        # A policy that remembers goes on seeing the episodes that are over.
        shown = running if player.reset is None else np.arange(len(labyrinths))
        seen = spec.look([(labyrinths[number], states[number]) for number in shown.tolist()])
        actions = decide(player.act, seen, np.searchsorted(shown, running))
        for number, action in zip(running.tolist(), actions.tolist(), strict=True):
            states[number] = transition(labyrinths[number], states[number], action)
            taken[number].append(action)
        over = [is_terminal(labyrinths[number], states[number]) for number in running.tolist()]
        running = running[~np.array(over)]
        if not running.size:
            break
    return [replay(labyrinth, each) for labyrinth, each in zip(labyrinths, taken, strict=True)]
