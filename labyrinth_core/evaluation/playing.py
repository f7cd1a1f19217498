"""Play episodes in `LabyrinthArrays`: one loop, `play`, moves all agents one step at a time.

All acting goes through it: policies with memory and without, the baselines, and the attempts during
training. An episode that is in the same situation again would go on as before, so it ends there.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.answers import (
    Policy,
    PolicyError,
    decide,
    in_our_form,
    memory_of,
    remembers,
    takes,
)
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.scores import Episodes, Scores, mean_if_any
from labyrinth_core.world import Episode

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

ADVICE = (
    "give episodes=1 or more if it draws at random, or reset(count) and act(observations) if it "
    "remembers"
)
"""What to do with a policy that answers the same observations differently."""

_ALLOWED = (
    "policy: give a function from observations to actions, or an object with reset(count) and "
    "act(observations), or with predict as in Stable-Baselines3"
)

Choose = Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.int64]]
"""Maps the states of all N agents and the M agents that still act to the M actions."""

FirstSeen = Callable[[int, NDArray[np.int64], NDArray[np.int64]], NDArray[np.int64]]
"""Maps a step, the M agents that still act and the states that they have reached to the step in
which each was in this situation for the first time, shape (M,)."""


def play(
    arrays: LabyrinthArrays,
    choose: Choose,
    *,
    start: NDArray[np.int64] | None = None,
    limit: int | None = None,
    first_seen: FirstSeen | None = None,
) -> Episodes:
    """Return the results of one episode of each agent.

    Args:
        arrays: The labyrinths.
        choose: Returns the actions.
        start: The state in which each of N agents begins, shape (N,), no two in one labyrinth;
            None for the initial state of every labyrinth.
        limit: The number of steps after which an episode is cut; None for the step limit.
        first_seen: Finds the episodes that are in a situation again: they end, and count as cut.
            None to play on.
    """
    state = (arrays.initial if start is None else start).copy()
    limit = arrays.step_limit if limit is None else limit
    moves = np.full(len(state), limit)
    moved = np.zeros(len(state), np.int64)  # The last step in which the agent left its state.
    running = np.arange(len(state))
    for step in range(1, limit + 1):
        here = state[running]
        after = arrays.next_state[here, choose(state, running)]
        state[running] = after
        moved[running[after != here]] = step
        ended = arrays.terminal[after]
        moves[running[ended]] = step
        running = running[~ended]
        if first_seen is not None:
            first = first_seen(step, running, state[running])
            # Whatever has happened since then repeats until the end.
            moved[running[(first < step) & (moved[running] > first)]] = limit
            running = running[first == step]
        if not running.size:
            break
    # An agent without memory that stays in a state reached it within as many steps as there are
    # states, long before half of the steps are over.
    ends = [arrays.goal[state], arrays.terminal[state], moved < arrays.step_limit / 2]
    return Episodes(np.select(ends, ["solved", "ice", "wall"], "loop"), moves, arrays.cells)


def by_state(arrays: LabyrinthArrays, start: NDArray[np.int64]) -> FirstSeen:
    """Return when agents without memory, which begin in `start`, reached each state first."""
    reached = np.full(len(arrays.terminal), sys.maxsize)
    reached[start] = 0

    def first_seen(
        step: int,
        running: NDArray[np.int64],  # noqa: ARG001
        states: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        reached[states] = np.minimum(reached[states], step)
        return reached[states]

    return first_seen


def follow(arrays: LabyrinthArrays, actions: NDArray[np.int64]) -> Episodes:
    """Return the results of a policy's episodes, given its action in each state, shape (S,)."""
    first_seen = by_state(arrays, arrays.initial)
    return play(arrays, lambda state, running: actions[state[running]], first_seen=first_seen)


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


@dataclass(frozen=True)
class Player:
    """Any policy, in the form in which it is called and plays.

    Each method raises a PolicyError if the policy raises an error, or answers with anything but
    actions.
    """

    act: Policy
    reset: Callable[[int], object] | None
    """Begins `count` episodes at once; None for a function."""
    forgets: bool
    """Whether the action depends on the observation alone, so that look-ups suffice."""
    remembered: Callable[[], NDArray[Any]] | None = None
    """Returns all that it remembers, a row for each episode; None if the policy cannot."""
    numbered: bool = False
    """Whether `act` takes `episodes`, the numbers of those that go on, and sees only these."""

    @classmethod
    def of(cls, policy: Any, seed: int = 0) -> Player:
        """Wrap any policy that `evaluate` accepts.

        A policy with an argument `rng` gets a generator with this seed.

        Raises:
            PolicyError: `evaluate` does not accept the policy.
        """
        if isinstance(policy, type):
            raise PolicyError(f"{_ALLOWED}, not the class {policy.__name__}")
        policy = PolicyError.calling(in_our_form, policy)
        has_memory = remembers(policy)
        if not (has_memory or callable(policy)):
            raise PolicyError(f"{_ALLOWED}, not an object of {type(policy).__name__}")
        begin = policy.reset if has_memory else policy
        draws = takes(begin, "rng")
        if draws:
            begin = partial(begin, rng=np.random.default_rng(seed))
        if has_memory:
            remembered = None if draws else getattr(policy, "remembered", None)
            return cls(policy.act, begin, False, remembered, takes(policy.act, "episodes"))
        return cls(begin, None, not draws)

    def act_in(self, episodes: NDArray[np.int64]) -> Policy:
        """Return `act` for observations of these episodes alone, which has to be `numbered`."""
        act: Any = self.act
        return partial(act, episodes=episodes)

    def decisions(self, arrays: LabyrinthArrays, states: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the action of a function in each of N states, one at least, shape (N,)."""
        parts = [states[begin:][:SEEN_TOGETHER] for begin in range(0, len(states), SEEN_TOGETHER)]
        return np.concatenate([decide(self.act, arrays.observations[part]) for part in parts])

    def score(self, arrays: LabyrinthArrays) -> Scores:
        """Return the scores of a policy without memory, by look-ups in all states at once."""
        acting = np.flatnonzero(~arrays.terminal)
        actions = np.zeros(len(arrays.terminal), np.int64)
        actions[acting] = self.decisions(arrays, acting)
        right = np.take_along_axis(arrays.optimal, actions[:, None], axis=1)[:, 0]
        solvable, shown = arrays.optimal.any(axis=1), arrays.on_demonstration
        return Scores(
            episodes=follow(arrays, actions),
            labyrinth_ids=arrays.labyrinth_ids,
            distance=arrays.distance,
            accuracy_on_demonstrations=mean_if_any(right[solvable & shown]),
            accuracy_elsewhere=mean_if_any(right[solvable & ~shown]),
        )

    def success_rate(self, arrays: LabyrinthArrays) -> float:
        """Return the share of labyrinths that the policy solves in one episode each.

        Without memory it is called only for the states that it visits, at 5x5 about a third of all.
        """
        played = self.play_once(arrays) if self.forgets else self.step_through(arrays, 1)
        return float(played.solved.mean())

    def play_once(self, arrays: LabyrinthArrays, limit: int | None = None) -> Episodes:
        """Return the results of one episode in each of L labyrinths, shape (L,).

        The policy acts in all of them at once.

        Args:
            arrays: The labyrinths.
            limit: The number of steps after which an episode is cut; None for the step limit.
        """
        if not self.forgets:
            first_seen = self._by_memory(len(arrays.initial))
            return self._play(arrays, arrays.initial, limit=limit, first_seen=first_seen)

        def choose(state: NDArray[np.int64], running: NDArray[np.int64]) -> NDArray[np.int64]:
            return self.decisions(arrays, state[running])

        return play(arrays, choose, limit=limit, first_seen=by_state(arrays, arrays.initial))

    def step_through(self, arrays: LabyrinthArrays, episodes: int) -> Episodes:
        """Return the results of `episodes` episodes in each of L labyrinths, shape (episodes, L).

        A policy that remembers and does not take the numbers of the episodes that go on is still
        shown the final states of finished ones, and its answers there are ignored.

        Args:
            arrays: The labyrinths.
            episodes: The number of episodes in each labyrinth.
        """
        rows = [
            [
                self._play(arrays, start, first_seen=self._by_memory(len(start)))
                for start in _together(arrays)
            ]
            for _ in range(episodes)
        ]
        return Episodes(
            np.stack([np.concatenate([each.outcomes for each in row]) for row in rows]),
            np.stack([np.concatenate([each.moves for each in row]) for row in rows]),
            arrays.cells,
        )

    def attempts(self, arrays: LabyrinthArrays, which: Sequence[int]) -> list[Episode]:
        """Return an episode in each of the labyrinths `which`, cut after as many steps as cells."""
        taken: list[list[int]] = [[] for _ in which]

        def note(
            state: NDArray[np.int64],  # noqa: ARG001
            running: NDArray[np.int64],
            actions: NDArray[np.int64],
        ) -> None:
            for agent, action in zip(running.tolist(), actions.tolist(), strict=True):
                taken[agent].append(action)

        self._play(arrays, arrays.initial[list(which)], limit=arrays.cells, note=note)
        return [
            arrays.labyrinths[number].replay(actions)
            for number, actions in zip(which, taken, strict=True)
        ]

    def counted_actions(self, arrays: LabyrinthArrays, episodes: int | None) -> NDArray[np.int64]:
        """Return how often the policy takes each action in each state of its episodes, (S, 4).

        Args:
            arrays: The labyrinths.
            episodes: The number of episodes in each labyrinth. None for one, which ends when a
                policy without memory returns to a state.
        """
        counts = np.zeros((len(arrays.terminal), 4), np.int64)

        def note(
            state: NDArray[np.int64], running: NDArray[np.int64], actions: NDArray[np.int64]
        ) -> None:
            counts[state[running], actions] += 1  # No two agents are in the same labyrinth.

        for start in _together(arrays) * (episodes or 1):
            if self.forgets and episodes is None:
                first_seen: FirstSeen | None = by_state(arrays, start)
            else:
                first_seen = self._by_memory(len(start))
            self._play(arrays, start, note=note, first_seen=first_seen)
        return counts

    def _play(
        self,
        arrays: LabyrinthArrays,
        start: NDArray[np.int64],
        *,
        limit: int | None = None,
        note: Callable[..., None] | None = None,
        first_seen: FirstSeen | None = None,
    ) -> Episodes:
        """Begin an episode of an agent in each state of `start`, and play them all.

        `note` is given the arguments and the result of each choice.
        """
        if self.reset is not None:
            PolicyError.calling(self.reset, len(start))

        def choose(state: NDArray[np.int64], running: NDArray[np.int64]) -> NDArray[np.int64]:
            if self.numbered:
                actions = decide(self.act_in(running), arrays.observations[state[running]])
            elif self.reset is None:
                actions = decide(self.act, arrays.observations[state[running]])
            else:
                actions = decide(self.act, arrays.observations[state], running)
            if note is not None:
                note(state, running, actions)
            return actions

        return play(arrays, choose, start=start, limit=limit, first_seen=first_seen)

    def _by_memory(self, count: int) -> FirstSeen | None:
        """Return when `count` agents had the same memory in the same state first.

        Return None if the policy has no `remembered`.
        """
        remembered = self.remembered
        if remembered is None:
            return None
        reached: dict[tuple[int, int, bytes], int] = {}

        def first_seen(
            step: int, running: NDArray[np.int64], states: NDArray[np.int64]
        ) -> NDArray[np.int64]:
            held = memory_of(remembered, count)
            agents = zip(running.tolist(), states.tolist(), strict=True)
            situations = ((agent, state, held[agent].tobytes()) for agent, state in agents)
            return np.array([reached.setdefault(each, step) for each in situations], np.int64)

        return first_seen

    def require_repeatable(self, arrays: LabyrinthArrays, advice: str = ADVICE) -> None:
        """Raise a PolicyError if two calls of a policy without memory differ.

        The second call shows the same observations in another order, one half at a time, to find a
        policy whose answer depends on the rest of the batch.

        `advice` says what to do with a policy that draws at random.
        """
        acting = np.flatnonzero(~arrays.terminal)
        some = acting[np.linspace(0, len(acting) - 1, min(TRIED, len(acting)), dtype=np.int64)]
        first = decide(self.act, arrays.observations[some])
        second = np.empty_like(first)
        for begin in range(min(2, len(some))):
            half = np.arange(len(some))[::-1][begin::2]
            second[half] = decide(self.act, arrays.observations[some[half]])
        if np.array_equal(first, second):
            return
        again = (decide(self.act, arrays.observations[some]) for _ in range(ASKED_AGAIN))
        if not all(np.array_equal(first, each) for each in again):
            raise PolicyError(f"the policy answers the same observations differently: {advice}")
        if (differing := int((first != second).sum())) > ROUNDED * len(some):
            raise PolicyError(
                f"the policy answers {differing} of {len(some)} observations differently in "
                "another batch: give one that answers each observation by itself, such as a "
                "network in evaluation mode"
            )


def _together(arrays: LabyrinthArrays) -> list[NDArray[np.int64]]:
    """Return the initial states of all labyrinths, in parts that a policy plays at once."""
    return [arrays.initial[begin:][:TOGETHER] for begin in range(0, len(arrays.initial), TOGETHER)]
