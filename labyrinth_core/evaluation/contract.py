"""Check that a policy keeps the promises that `evaluate` relies on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.answers import PolicyError, decide, fitted, memory_of
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.playing import ROUNDED, Player
from labyrinth_core.pictures import ObservationSpec
from labyrinth_core.world import Labyrinth, Task, sample_labyrinth

LABYRINTHS = 8
"""The number of labyrinths in which a policy is checked."""


def check_policy(
    policy: Any,
    *,
    height: int = 3,
    width: int = 3,
    task: str = Task.NAVIGATION,
    observation: str | None = None,
    image_size: int | None = None,
) -> None:
    """Check that a policy keeps the promises of docs/evaluation.md, "Policy interface".

    A policy that passes may still solve nothing, but `evaluate`, `compare` and a replay of its
    results mean what they say.

    Args:
        policy: Any policy that `evaluate` accepts.
        height: Rows of the labyrinths to act in.
        width: Columns of these labyrinths.
        task: The task of these labyrinths.
        observation: As for `evaluate`.
        image_size: As for `evaluate`.

    Raises:
        AssertionError: A promise is broken; the message says which, and the cause how.
        ValueError: An argument other than the policy has a value that is not allowed.
    """
    rng = np.random.default_rng(0)
    with _promised("A policy can be shown labyrinths of the size and task that it is used for."):
        fit, spec = fitted(
            policy, height, width, Task(task), observation=observation, image_size=image_size
        )
    with _promised("A policy is a function, a PyTorch module, or has reset and act, or predict."):
        player = Player.of(fit, seed=0)
    labyrinths = {sample_labyrinth(height, width, Task(task), rng) for _ in range(4 * LABYRINTHS)}
    some = sorted(labyrinths, key=str)[:LABYRINTHS]
    arrays = LabyrinthArrays.of_labyrinths(some, spec)
    if player.reset is None:
        _check_function(player, arrays)
    else:
        _check_episodes(fit, player, some, spec)
    with _promised("A policy acts until an episode ends."):
        player.play_once(arrays, arrays.cells)


def _check_function(player: Player, arrays: LabyrinthArrays) -> None:
    """Check a policy without memory."""
    acting = np.flatnonzero(~arrays.terminal)
    seen = arrays.observations[acting]
    for count in (1, len(acting)):
        with _promised(
            "A function answers B observations with B actions, 0 to 3, or with scores of shape "
            "(B, 4), for one observation and for many."
        ):
            decide(player.act, seen[:count].copy())
    _check_unchanged(player, seen)
    if player.forgets:
        with _promised(
            "A function answers each observation by itself: the same way again, in another order "
            "and beside others. A stochastic policy takes an argument rng."
        ):
            player.require_repeatable(
                arrays,
                "take an argument rng if it draws at random, or reset(count) and "
                "act(observations) if it remembers",
            )


def _check_episodes(
    policy: Any, player: Player, labyrinths: list[Labyrinth], spec: ObservationSpec
) -> None:
    """Check a policy with reset and act."""
    arrays = LabyrinthArrays.of_labyrinths(labyrinths, spec)
    with _promised("reset(count) begins count episodes, and act answers with an action for each."):
        first = _played(policy, arrays)
    with _promised("act answers with actions, for one episode as for several."):
        alone = _played(policy, LabyrinthArrays.of_labyrinths(labyrinths[:1], spec))
    with _promised("reset(count) forgets all earlier episodes: the same ones go the same way."):
        assert _are_alike(first, _played(policy, arrays))
    if _are_alike(first, _played(policy, arrays, seed=1)):  # Else it draws at random.
        with _promised("What happens in an episode does not depend on the episodes beside it."):
            assert _are_alike(first[:1], alone)
    assert player.reset is not None
    player.reset(len(labyrinths))
    seen = arrays.observations[arrays.initial]
    if player.numbered:
        player.act_in(np.arange(len(labyrinths)))(seen)
    else:
        _check_unchanged(player, seen)
    if player.remembered is not None:
        with _promised("remembered() returns an array with a row for each episode."):
            memory_of(player.remembered, len(labyrinths))


def _played(policy: Any, arrays: LabyrinthArrays, seed: int = 0) -> list[list[int]]:
    """Return the actions of an episode in each labyrinth, of as many steps as there are cells."""
    played = Player.of(policy, seed).attempts(arrays, range(len(arrays.labyrinths)))
    return [each.actions.tolist() for each in played]


def _are_alike(one: list[list[int]], other: list[list[int]]) -> bool:
    """Return whether episodes are equal but for what rounding in other batches may change."""
    unlike = sum(mine != theirs for mine, theirs in zip(one, other, strict=True))
    return unlike <= ROUNDED * len(one)


def _check_unchanged(player: Player, seen: NDArray[Any]) -> None:
    shown = seen.copy()
    with _promised("A policy does not change the observations that it is given."):
        decide(player.act, shown)
        assert np.array_equal(seen, shown)


@contextmanager
def _promised(sentence: str) -> Iterator[None]:
    """Turn what goes wrong inside the block into the sentence that was promised."""
    try:
        yield
    except (PolicyError, AssertionError) as error:
        told = f" It does not: {error}" if str(error) else ""
        raise AssertionError(f"{sentence}{told}") from error
