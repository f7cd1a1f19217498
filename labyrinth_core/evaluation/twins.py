"""The statistic of `memorised`: does a policy act as its own train shows, where that is unusual?

The twins of a state in a training set are the demonstrated states that look most like it, among
those with the agent in the same cell, the key and the door in the same condition: the fewest
entries of their vector observations differ. In navigation these are passages.

Which action most training sets show in a state, the consensus, says nothing about a single set. So
the excess of a policy is a covariance: it is positive if the policy takes the actions that a set
shows more often than the consensus does.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from math import ceil

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import DatasetConfig, Drawing
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.pictures import ObservationSpec
from labyrinth_core.world import Labyrinth, Labyrinths

FIRST_SEED = 2**62
"""The seed of the first control. A control with the seed of the dataset is left out."""

COMPARED = 2**20
"""The largest number of pairs of states that are compared at once; they take about 50 MB."""

ENTRIES = 2**23
"""The largest number of entries of demonstrated states that are compared at once, 32 MB, or as many
as those of one training set."""

SOFTNESS = 2.0
"""The number of differences that divides the weight of a demonstrated state by e, in `likely`."""


TrainSet = tuple[DatasetConfig, Sequence[Labyrinth]]
"""A config, whose seed also decides what is demonstrated, and the labyrinths of its train."""


def train_set(config: DatasetConfig) -> TrainSet:
    """Draw the train of a dataset; it is shorter than `config.labyrinths` if no more are found."""
    return config, list(islice(Drawing(config).labyrinths("train"), config.labyrinths))


def control_sets(config: DatasetConfig, count: int) -> Iterator[TrainSet]:
    """Draw `count` training sets like that of a dataset, with other seeds."""
    seeds = (seed for seed in range(FIRST_SEED, FIRST_SEED + count + 1) if seed != config.seed)
    for seed in islice(seeds, count):
        yield train_set(replace(config, seed=seed))


@dataclass(frozen=True, eq=False)
class Demonstrated:
    """The M states in which the demonstrations of some training sets act."""

    labyrinths: Labyrinths
    """The labyrinths of all sets."""
    train: NDArray[np.int64]
    """The number of each state's training set, ascending, shape (M,)."""
    labyrinth: NDArray[np.int64]
    """The number of each state's labyrinth among `labyrinths`, shape (M,)."""
    state: NDArray[np.int64]
    """The index of each state in its labyrinth, as in `Labyrinth.state_index`, shape (M,)."""
    shares: NDArray[np.float32]
    """The share of the demonstrations that take each action in the state, shape (M, 4)."""

    @classmethod
    def of(cls, sets: Iterable[TrainSet]) -> Demonstrated:
        """Solve the labyrinths of training sets as the build of the dataset does.

        Each set is packed before the next one is drawn: a labyrinth takes 5 KB until then.
        """
        batches: list[Labyrinths] = []
        taken: dict[tuple[int, int, int], list[int]] = {}
        number = 0
        for train, (config, labyrinths) in enumerate(sets):
            batches.append(Labyrinths.of(labyrinths))
            for labyrinth in labyrinths:
                for episode in Drawing(config).episodes("train", labyrinth):
                    actions = episode.actions.tolist()
                    for state, action in zip(episode.states[:-1], actions, strict=True):
                        key = train, number, labyrinth.state_index(state)
                        taken.setdefault(key, [0, 0, 0, 0])[action] += 1
                number += 1
        counts = np.array([*taken.values()], np.float32)
        shares = counts / counts.sum(axis=1, keepdims=True)
        train_of, labyrinth_of, state_of = np.array([*taken], np.int64).T
        return cls(_joined(batches), train_of, labyrinth_of, state_of, shares)


def _joined(parts: Sequence[Labyrinths]) -> Labyrinths:
    structures = replace(
        parts[0].structures,
        up=np.concatenate([each.structures.up for each in parts]),
        right=np.concatenate([each.structures.right for each in parts]),
    )
    tiles, ground = ([getattr(each, name) for each in parts] for name in ("tiles", "ground"))
    return replace(
        parts[0], structures=structures, tiles=np.concatenate(tiles), ground=np.concatenate(ground)
    )


def compared(
    arrays: LabyrinthArrays, states: NDArray[np.int64], sets: Demonstrated
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]:
    """Yield some of the states, the demonstrated states that may be their twins, and differences.

    The first two are numbers in `states`, shape (A,), and in `sets`, shape (B,). The last is the
    number of entries in which their vectors differ, shape (A, B). All candidates that a training
    set has for a state come together.
    """
    batch = Labyrinths.of(arrays.labyrinths)
    tiles = batch.task.rules.positions
    length = _vectors(batch, np.array([0]), np.array([0])).size
    here = arrays.state[states]
    for state in np.unique(here).tolist():
        asked = np.flatnonzero(here == state)
        for shown in _in_blocks(np.flatnonzero(sets.state == state), sets.train, length):
            theirs = _vectors(sets.labyrinths, sets.labyrinth[shown], sets.state[shown])
            for some in np.array_split(asked, ceil(len(asked) * len(shown) / COMPARED)):
                which = states[some]
                ours = _vectors(batch, arrays.labyrinth[which], arrays.state[which])
                yield some, shown, _differences(ours, theirs, tiles)


def _in_blocks(
    numbers: NDArray[np.int64], train: NDArray[np.int64], length: int
) -> Iterator[NDArray[np.int64]]:
    """Yield numbers of demonstrated states in blocks of whole training sets.

    Args:
        numbers: The numbers, ascending.
        train: The training set of each demonstrated state.
        length: The number of entries of a vector.
    """
    trains = np.unique(train[numbers])
    count = min(len(trains), ceil(len(numbers) * length / ENTRIES))
    for some in np.array_split(trains, count) if count else ():
        first, last = np.searchsorted(train[numbers], [some[0], some[-1] + 1])
        yield numbers[first:last]


def _vectors(
    labyrinths: Labyrinths, which: NDArray[np.int64], states: NDArray[np.int64]
) -> NDArray[np.int32]:
    alone = np.arange(len(which))
    return ObservationSpec("vector").look_together(labyrinths.take(which), alone, states)


def _differences(
    ours: NDArray[np.int32], theirs: NDArray[np.int32], tiles: int
) -> NDArray[np.int64]:
    """Return in how many entries vectors differ, shape (A, B); the first `tiles` are positions."""
    varying = (np.concatenate([ours, theirs]) != ours[0]).any(axis=0)
    differing = np.full((len(ours), len(theirs)), varying.sum(), np.float32)
    for entry in np.flatnonzero(varying[:tiles]).tolist():
        differing -= ours[:, entry, None] == theirs[:, entry]
    ours, theirs = ours[:, tiles:][:, varying[tiles:]], theirs[:, tiles:][:, varying[tiles:]]
    for value in np.unique(ours).tolist():
        differing -= (ours == value).astype(np.float32) @ (theirs == value).astype(np.float32).T
    return differing.astype(np.int64)


@dataclass(frozen=True, eq=False)
class Twins:
    """What some training sets show in N states of a split."""

    shown: NDArray[np.float32]
    """The share of the twins that show each action, shape (sets, N, 4); nan without a twin."""
    likely: NDArray[np.int8]
    """The action that a policy takes which has learnt this set alone, and acts as the demonstrated
    states do that look alike, the more the more alike they look; shape (sets, N)."""

    @classmethod
    def of(cls, arrays: LabyrinthArrays, states: NDArray[np.int64], sets: Demonstrated) -> Twins:
        """Find the twins of states in each training set; equally near twins count alike.

        Args:
            arrays: The labyrinths of the split.
            states: The indices of the N states in `arrays`.
            sets: The demonstrated states of the training sets.
        """
        shape = int(sets.train[-1]) + 1, len(states)
        shown, likely = np.full((*shape, 4), np.nan, np.float32), np.zeros(shape, np.int8)
        for some, demonstrated, differences in compared(arrays, states, sets):
            trains, first = np.unique(sets.train[demonstrated], return_index=True)
            least = np.minimum.reduceat(differences, first, axis=1)
            sizes = np.diff(first, append=len(demonstrated))
            behind = differences - np.repeat(least, sizes, axis=1)
            shares = sets.shares[demonstrated]
            votes = _votes((behind == 0).astype(np.float32), shares, first)
            shown[trains[:, None], some] = votes / votes.sum(axis=2, keepdims=True)
            votes = _votes(np.exp(-behind / SOFTNESS, dtype=np.float32), shares, first)
            likely[trains[:, None], some] = most_shown(votes)
        return cls(shown, likely)

    def joined(self, other: Twins) -> Twins:
        """Return these sets and then those of another."""
        return Twins(
            np.concatenate([self.shown, other.shown]), np.concatenate([self.likely, other.likely])
        )

    @cached_property
    def consensus(self) -> NDArray[np.float32]:
        """The mean of `shown` over all other sets, shape (sets, N, 4).

        It is nan where this set has no twin, or no other set has one.
        """
        total = np.nansum(self.shown, axis=0, dtype=np.float64)
        others = (~np.isnan(self.shown[:, :, :1])).sum(axis=0) - 1
        consensus = np.empty_like(self.shown)
        for mean, shown in zip(consensus, self.shown, strict=True):
            mean[:] = np.where(others > 0, (total - shown) / np.maximum(others, 1), np.nan)
        return consensus

    def excess(self, actions: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return how much more a policy follows each set than the consensus of the others explains.

        Args:
            actions: The share of each action that the policy takes in the states, shape (N, 4), or
                (sets, N, 4) for a policy for each set.

        Returns:
            The excess in each state, shape (sets, N); nan without a twin.
        """
        excess = np.empty(self.likely.shape)
        each = np.broadcast_to(actions.astype(np.float32), self.shown.shape)
        for train, usual in enumerate(self.consensus):
            followed = (each[train] - usual) * (self.shown[train] - usual)
            excess[train] = followed.sum(axis=1, dtype=np.float64)
        return excess

    def others(self) -> NDArray[np.float32]:
        """Return how the policies of `likely` act that have not learnt a set, (sets, N, 4)."""
        each = np.eye(4, dtype=np.float32)[self.likely]
        others: NDArray[np.float32] = (each.sum(axis=0) - each) / (len(each) - 1)
        return others


def most_shown(votes: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return the action with the most votes, shape (...), from (..., 4); of equal ones the first.

    Votes are rounded first, since another order of summation can decide between equal ones.
    """
    best: NDArray[np.int64] = votes.round(3).argmax(axis=-1)
    return best


def _votes(
    weights: NDArray[np.float32], shares: NDArray[np.float32], first: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Return the votes for each action by set, shape (sets, A, 4).

    Args:
        weights: The weight of each demonstrated state for each state, shape (A, B).
        shares: What is shown in the demonstrated states, shape (B, 4).
        first: The number of each set's first demonstrated state.
    """
    by_action = [np.add.reduceat(weights * each, first, axis=1).T for each in shares.T]
    votes: NDArray[np.float32] = np.stack(by_action, axis=2)
    return votes


def without_effects(
    excess: NDArray[np.float64], references: Sequence[NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return the excess without what each training set adds to that of any policy.

    A set whose labyrinths happen to resemble those of the split has an effect on every policy, also
    on one that never saw the set. The effect is estimated from reference policies that never saw it
    either: the means of the excess over the states are regressed on theirs. All sets are treated
    alike, so the rank of the real one stays valid.

    Args:
        excess: The excess of the policy, shape (sets, N).
        references: The excess of each reference policy in the same states.
    """
    means = mean_of(excess)
    effects = np.stack([np.ones(len(means)), *map(mean_of, references)], axis=1)
    (constant, *slopes), *_ = np.linalg.lstsq(effects, means)
    rest: NDArray[np.float64] = excess - constant
    for slope, reference in zip(slopes, references, strict=True):
        rest -= slope * reference
    return rest


def mean_of(excess: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of an excess over the states with a twin, shape (sets,); 0 without any."""
    known = (~np.isnan(excess)).sum(axis=1)
    means: NDArray[np.float64] = np.nansum(excess, axis=1) / np.maximum(known, 1)
    return means
