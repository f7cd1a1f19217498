"""Play episodes in `LabyrinthArrays`: one loop, `play`, moves all agents one step at a time.

All acting goes through it: policies with memory and without, the baselines, and the attempts during
training.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.answers import (
    Player,
    Policy,
    PolicyError,
    asked,
    decide,
    memory_of,
)
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.world import RULES, Episode

OUTCOMES = {
    "solved": "the goal is reached",
    "loop": "the agent goes round between cells until the episode is cut",
    "wall": "the agent walks into a wall or a locked door until the episode is cut",
    "ice": "the agent steps on ice",
    "cut": "a fixed route ends elsewhere than on the goal",
}
"""Outcome of an episode -> what happens."""

SEEN_TOGETHER = 256
"""The largest number of states that a policy sees at once; a ResNet-18 takes 1 MB for each."""

TOGETHER = 1024
"""The largest number of episodes that a policy with memory plays at once."""

TRIED = 256
"""The number of states for which a policy is called twice, to see if answers agree.

A policy that draws one in fifty of its answers at random is found in 999 of 1,000 cases: a random
action agrees with the other answer in a quarter of them.
"""

ASKED_AGAIN = 4
"""The number of further calls that decide whether differing answers are random."""

ROUNDED = 0.02
"""The largest share of answers that may depend on the batch: sums round differently in batches of
other sizes, which can decide between two equally good actions."""

Choose = Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.int64]]
"""Maps the states of all N agents and the M agents that still act to the M actions."""


@dataclass(frozen=True, eq=False)
class Episodes:
    """The results of one episode in each of L labyrinths; shapes are (E, L) for E episodes each."""

    outcomes: NDArray[np.str_]
    """Keys of `OUTCOMES`, shape (L,)."""
    moves: NDArray[np.int64]
    """Numbers of steps, those into walls included, shape (L,)."""
    cells: int
    """The number of cells of a labyrinth."""

    @classmethod
    def of_letters(
        cls, letters: Sequence[str], moves: Sequence[Sequence[int]], cells: int
    ) -> Episodes:
        """Return E episodes in each of L labyrinths, from E texts as `letters` returns them."""
        names = {name[0]: name for name in OUTCOMES}
        outcomes = np.array([[names[letter] for letter in row] for row in letters])
        return cls(outcomes, np.array(moves, np.int64), cells)

    @property
    def letters(self) -> list[str]:
        """One text per episode E: the first letter of the outcome in each labyrinth."""
        return ["".join(name[0] for name in row) for row in np.atleast_2d(self.outcomes).tolist()]

    @property
    def step_limit(self) -> int:
        """The number of steps after which an episode is cut."""
        return RULES.step_limit * self.cells

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Whether the goal was reached, shape (L,)."""
        solved: NDArray[np.bool_] = self.outcomes == "solved"
        return solved

    @property
    def returns(self) -> NDArray[np.float64]:
        """Sums of the rewards, shape (L,); exactly -4 for an episode that is cut.

        Computed as a product, since a sum of many small penalties gathers rounding errors.
        """
        ends = np.select(
            [self.solved, self.outcomes == "ice"], [RULES.goal_reward, RULES.ice_reward]
        )
        returns: NDArray[np.float64] = (
            ends - RULES.step_penalty * (self.moves - (ends != 0)) / self.cells
        )
        return returns


def play(
    arrays: LabyrinthArrays,
    choose: Choose,
    *,
    start: NDArray[np.int64] | None = None,
    limit: int | None = None,
    visits: int | None = None,
    remembered: Callable[[], NDArray[Any]] | None = None,
) -> Episodes:
    """Return the results of one episode of each agent.

    Args:
        arrays: The labyrinths.
        choose: Returns the actions.
        start: The state in which each of N agents begins, shape (N,), no two in one labyrinth;
            None for the initial state of every labyrinth.
        limit: The number of steps after which an episode is cut; None for the step limit.
        visits: An episode ends, and counts as cut, when its agent reaches a state in which it has
            acted that often: 1 for a policy without memory, which would repeat itself. None to
            play on.
        remembered: Returns all that a policy remembers, a row for each agent. An episode also ends
            when state and memory are the same as before.
    """
    state = (arrays.initial if start is None else start).copy()
    limit = arrays.step_limit if limit is None else limit
    moves = np.full(len(state), limit)
    moved = np.zeros(len(state), np.int64)  # The last step in which the agent left its state.
    acted = np.zeros(len(arrays.terminal), np.int64)
    first: dict[tuple[int, int, bytes], int] = {}
    running = np.arange(len(state))
    for step in range(1, limit + 1):
        here = state[running]
        after = arrays.next_state[here, choose(state, running)]
        state[running] = after
        moved[running[after != here]] = step
        ended = arrays.terminal[after]
        moves[running[ended]] = step
        going = ~ended
        if visits is not None:
            acted[here] += 1
            going &= acted[after] < visits
            moved[running[~going & ~ended & (after != here)]] = limit
        running = running[going]
        if remembered is not None:
            held = memory_of(remembered, len(state))
            situations = [(each, state[each], held[each].tobytes()) for each in running.tolist()]
            begun = np.array([first.setdefault(each, step) for each in situations], np.int64)
            # Whatever has happened since then repeats until the end.
            moved[running[(begun < step) & (moved[running] > begun)]] = limit
            running = running[begun == step]
        if not running.size:
            break
    # An agent without memory that stays in a state reached it within as many steps as there are
    # states, long before half of the steps are over.
    ends = [arrays.goal[state], arrays.terminal[state], moved < arrays.step_limit / 2]
    return Episodes(np.select(ends, ["solved", "ice", "wall"], "loop"), moves, arrays.cells)


# Policies without memory.


def decisions(
    policy: Policy, arrays: LabyrinthArrays, states: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the action of a policy in each of N states, shape (N,); at least one is given.

    Raises:
        PolicyError: The policy raises an error, or answers with anything but actions.
    """
    parts = [states[begin:][:SEEN_TOGETHER] for begin in range(0, len(states), SEEN_TOGETHER)]
    return np.concatenate([decide(policy, arrays.observations[part]) for part in parts])


def follow(arrays: LabyrinthArrays, actions: NDArray[np.int64]) -> Episodes:
    """Return the results of a policy's episodes, given its action in each state, shape (S,)."""
    return play(arrays, lambda state, running: actions[state[running]], visits=1)


def follow_route(arrays: LabyrinthArrays, route: Sequence[int]) -> Episodes:
    """Return the results of taking the same route in every labyrinth.

    After the last action the agent stays where it is until the episode is cut.
    """
    steps = iter(route)
    walked = play(arrays, lambda _, running: np.full(len(running), next(steps)), limit=len(route))
    ended = np.isin(walked.outcomes, ["solved", "ice"])
    return replace(
        walked,
        outcomes=np.where(ended, walked.outcomes, "cut"),
        moves=np.where(ended, walked.moves, arrays.step_limit),
    )


def success_rate(policy: Policy, arrays: LabyrinthArrays) -> float:
    """Return the share of labyrinths that a policy solves when acting greedily.

    The policy is called only for the states that it visits, at 5x5 about a third of all.
    """
    return float(_visit(policy, arrays, None).solved.mean())


def _visit(policy: Policy, arrays: LabyrinthArrays, limit: int | None) -> Episodes:
    """Return the results of a policy's episodes; it is called only for states that it visits."""

    def choose(state: NDArray[np.int64], running: NDArray[np.int64]) -> NDArray[np.int64]:
        return decisions(policy, arrays, state[running])

    return play(arrays, choose, visits=1, limit=limit)


# Any policy.


class UnrepeatableError(PolicyError):
    """A policy without memory answers the same observations differently."""


def require_repeatable(player: Player, arrays: LabyrinthArrays, advice: str) -> None:
    """Raise an UnrepeatableError if two calls of a policy without memory differ.

    The second call shows the same observations in another order, one half at a time, to find a
    policy whose answer depends on the rest of the batch.

    `advice` says what to do with a policy that draws at random.
    """
    acting = np.flatnonzero(~arrays.terminal)
    some = acting[np.linspace(0, len(acting) - 1, min(TRIED, len(acting)), dtype=np.int64)]
    first = decide(player.act, arrays.observations[some])
    second = np.empty_like(first)
    for begin in range(min(2, len(some))):
        half = np.arange(len(some))[::-1][begin::2]
        second[half] = decide(player.act, arrays.observations[some[half]])
    if np.array_equal(first, second):
        return
    again = (decide(player.act, arrays.observations[some]) for _ in range(ASKED_AGAIN))
    if not all(np.array_equal(first, each) for each in again):
        raise UnrepeatableError(
            f"the policy answers the same observations differently: {advice}, or reset(count) and "
            "act(observations) if it remembers"
        )
    if (differing := int((first != second).sum())) > ROUNDED * len(some):
        raise PolicyError(
            f"the policy answers {differing} of {len(some)} observations differently in another "
            "batch: give one that answers each observation by itself, such as a network in "
            "evaluation mode"
        )


def play_once(player: Player, arrays: LabyrinthArrays, limit: int) -> Episodes:
    """Return the results of one episode in each of L labyrinths, shape (L,).

    Args:
        player: The policy.
        arrays: The labyrinths, in which it acts all at once.
        limit: The number of steps after which an episode is cut.

    Raises:
        PolicyError: The policy raises an error, or answers with anything but actions.
    """
    if player.forgets:
        return _visit(player.act, arrays, limit)
    choose = _begun(player, arrays, len(arrays.initial))
    return play(arrays, choose, limit=limit, remembered=player.remembered)


def step_through(player: Player, arrays: LabyrinthArrays, episodes: int) -> Episodes:
    """Return the results of `episodes` episodes in each of L labyrinths, shape (episodes, L).

    Args:
        player: The policy. If it remembers and does not take the numbers of the episodes that go
            on, it is still shown the final states of finished ones, and its answers there are
            ignored.
        arrays: The labyrinths.
        episodes: The number of episodes in each labyrinth.

    Raises:
        PolicyError: The policy raises an error, or answers with anything but actions.
    """
    first = range(0, len(arrays.initial), TOGETHER)
    starts = [arrays.initial[begin:][:TOGETHER] for begin in first]
    rows = [
        [
            play(
                arrays, _begun(player, arrays, len(each)), start=each, remembered=player.remembered
            )
            for each in starts
        ]
        for _ in range(episodes)
    ]
    return Episodes(
        np.stack([np.concatenate([each.outcomes for each in row]) for row in rows]),
        np.stack([np.concatenate([each.moves for each in row]) for row in rows]),
        arrays.cells,
    )


def attempts(player: Player, arrays: LabyrinthArrays, which: Sequence[int]) -> list[Episode]:
    """Return one episode in each of the labyrinths `which`, cut after as many steps as cells.

    Raises:
        PolicyError: The policy raises an error, or answers with anything but actions.
    """
    choose = _begun(player, arrays, len(which))
    taken: list[list[int]] = [[] for _ in which]

    def noted(state: NDArray[np.int64], running: NDArray[np.int64]) -> NDArray[np.int64]:
        actions = choose(state, running)
        for agent, action in zip(running.tolist(), actions.tolist(), strict=True):
            taken[agent].append(action)
        return actions

    play(arrays, noted, start=arrays.initial[list(which)], limit=arrays.cells)
    return [
        arrays.labyrinths[place].replay(actions)
        for place, actions in zip(which, taken, strict=True)
    ]


def counted_actions(
    player: Player, arrays: LabyrinthArrays, episodes: int | None
) -> NDArray[np.int64]:
    """Return how often a policy takes each action in each state of its episodes, shape (S, 4).

    Args:
        player: The policy.
        arrays: The labyrinths.
        episodes: The number of episodes in each labyrinth. None for one, which ends when a policy
            without memory returns to a state.

    Raises:
        PolicyError: The policy raises an error, or answers with anything but actions.
    """
    counts = np.zeros((len(arrays.terminal), 4), np.int64)
    visits = 1 if player.forgets and episodes is None else None
    for begin in [*range(0, len(arrays.initial), TOGETHER)] * (episodes or 1):
        start = arrays.initial[begin:][:TOGETHER]
        choose = _begun(player, arrays, len(start))

        def noted(
            state: NDArray[np.int64], running: NDArray[np.int64], choose: Choose = choose
        ) -> NDArray[np.int64]:
            actions = choose(state, running)
            counts[state[running], actions] += 1  # No two agents are in the same labyrinth.
            return actions

        play(arrays, noted, start=start, visits=visits, remembered=player.remembered)
    return counts


def _begun(player: Player, arrays: LabyrinthArrays, count: int) -> Choose:
    """Begin `count` episodes, and return the function with which the policy acts in them."""
    if player.reset is None:
        return lambda state, running: decide(player.act, arrays.observations[state[running]])
    asked(player.reset, count)
    if player.numbered:
        return lambda state, running: decide(
            player.act_in(running), arrays.observations[state[running]]
        )
    return lambda state, running: decide(player.act, arrays.observations[state], running)
