"""The receipt of `memorised`: does a policy follow what its own training set happened to show?

from labyrinth_core import Dataset, load_policy, memorised

print(memorised(load_policy("runs/5x5/bc-cnn-seed0"), Dataset("data/labyrinth", "5x5")))

In the terms of the field, this is action memorisation (He et al. 2025, arXiv 2505.05787), tested by
the rank of the real training set among random ones, which is a training data proof (Zhang et al.
2024, arXiv 2409.19798). Control training sets can be drawn from the very distribution of the real
one. `twins` has the statistic.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core import typed
from labyrinth_core.checks import whole
from labyrinth_core.data import Dataset, DatasetConfig
from labyrinth_core.evaluation.answers import ACTIONS
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.playing import Player
from labyrinth_core.evaluation.scores import interval
from labyrinth_core.evaluation.twins import (
    FIRST_SEED,
    Demonstrated,
    TrainSet,
    Twins,
    compared,
    control_sets,
    mean_of,
    most_shown,
    train_set,
    without_effects,
)
from labyrinth_core.language import labyrinth_id
from labyrinth_core.world import Action, Labyrinth

SPLITS_WITHOUT_TRAIN = ("test", "validation")
"""The splits that do not depend on train: any other train could have been theirs."""

MOST_SHARED = 0.5
"""The largest share of the labyrinths of train that a control may have, too, on average."""

COPIES = 12
"""The number of copies in a receipt."""

PAIR_BYTES, MOST_BYTES = 110, 8 * 10**9
"""The memory for each state in each training set, and the most that a receipt may take."""

DECIMALS = 4
"""Figures are rounded to this number of decimal places, since processors round sums differently."""
EQUAL = 1e-9
"""Two excesses that differ by no more are equal, for the same reason."""


_Shares = tuple[typed.Share, typed.Share, typed.Share, typed.Share]


@dataclass(frozen=True)
class Excess:
    """How much more a policy follows its own train than controls, over some states."""

    excess: float
    """The excess, in percentage points of the states."""
    interval: tuple[float, float]
    """Its 95% interval over labyrinths."""
    controls: tuple[float, Annotated[float, typed.Within(0)]]
    """The mean and the standard deviation of the excess over the controls, in points."""
    p: typed.Share
    """The rank of the real train: (1 + controls with as much excess) / (1 + controls)."""
    most: float
    """The excess of a policy that follows its own train in every state, in points."""
    states: typed.Count
    """The number of states."""
    without_twin: typed.Count
    """How many of them have no twin in train; they do not count."""


@dataclass(frozen=True)
class Copy:
    """A state in which a policy acts as its own train shows, and other trains do not."""

    labyrinth: typed.LabyrinthId
    """The id of the labyrinth."""
    agent: typed.Count
    """The agent's cell, also in the twin."""
    has_key: bool
    """Whether the agent has the key, also in the twin."""
    door_open: bool
    """Whether the door is open, also in the twin."""
    train_labyrinth: typed.LabyrinthId
    """The id of the twin's labyrinth in train."""
    twins: typed.Positive
    """The number of equally near twins, of which this is one."""
    differences: typed.Count
    """The number of entries in which the vectors of the two states differ."""
    passages: tuple[tuple[typed.Count, typed.Count], ...]
    """The passages that only one of the two labyrinths has, as pairs of cells."""
    did: _Shares
    """The share of each action that the policy takes in the state."""
    shown: _Shares
    """The share of the twins that show each action."""
    consensus: _Shares
    """The mean of these shares over the controls."""
    optimal: tuple[bool, bool, bool, bool]
    """Whether each action begins a shortest route."""


@dataclass(frozen=True, repr=False)
class Receipt(Excess):
    """The result of `memorised`: the excess over all states, or over the policy's own way.

    A policy with memory has no action in a state by itself, so only its own way counts.
    """

    split: Annotated[str, typed.Like("|".join(SPLITS_WITHOUT_TRAIN))]
    train: Mapping[typed.Word, Any]
    """The options that draw the training set: those of its dataset, with the number of labyrinths
    that the policy has learnt from."""
    drawn: Annotated[int, typed.Within(*typed.CONTROLS)]
    """The number of control training sets."""
    shared: typed.Share
    """The mean share of the labyrinths of train that a control has, too. The more they share, the
    less can be found; p stays valid."""
    own_way: Excess
    """The same over the states that the policy visits."""
    everywhere: bool
    """Whether all states count, not only those of the policy's own way."""
    copies: tuple[Copy, ...] = field(default=())
    """The states with the greatest share in the excess, at most one in each labyrinth."""

    def __repr__(self) -> str:
        """Return the figures, one to a line, and the clearest copy."""
        way, states = self.own_way, "all states" if self.everywhere else "the policy's own way"
        lines = [
            f"Does the policy follow its own train? {self.split}, {self.drawn} controls",
            f"  excess    {_points(self)} points, {self.most:.1f} if it always did",
            f"  controls  {self.controls[0]:+z.2f} ± {self.controls[1]:.2f}",
            f"  p         {self.p:.3f}",
            f"  states    {self.states:,} of {states}, and {self.without_twin:,} without a twin",
        ]
        if self.everywhere:
            lines.append(f"  own way   {_points(way)} points, p {way.p:.3f}, {way.states:,} states")
        for copy in self.copies[:1]:
            did, shown = (
                Action(int(np.argmax(each))).name.lower() for each in (copy.did, copy.shown)
            )
            lines.append(
                f"  e.g. in {copy.labyrinth}, cell {copy.agent}: {did}, as in {shown} of "
                f"{copy.train_labyrinth}, where {copy.differences} entries differ"
            )
        return "\n".join(lines)


def _points(of: Excess) -> str:
    low, high = of.interval
    return f"{of.excess:+z.2f} [{low:+z.2f}, {high:+z.2f}]"


def receipt_of(
    player: Player,
    arrays: LabyrinthArrays,
    train: TrainSet,
    *,
    split: str,
    controls: int,
    episodes: int | None = None,
) -> Receipt:
    """Return the receipt of a policy in the labyrinths of a split; see `memorised`.

    They do not depend on the training set, which may be that of another dataset.
    """
    config, own_labyrinths = train
    # Any seed below gives the same controls, so that they are drawn once for many datasets.
    others, hashes = _controls(replace(config, seed=max(config.seed, FIRST_SEED - 1)), controls)
    shared = _shared(train, hashes)
    states = np.flatnonzero(~arrays.terminal)
    if (needed := PAIR_BYTES * (1 + controls) * len(states)) > MOST_BYTES:
        raise ValueError(
            f"controls={controls}: {len(states):,} states of {split} take about "
            f"{needed / 1e9:.0f} GB, more than {MOST_BYTES / 1e9:.0f}: give fewer controls"
        )
    actions = _everywhere(player, arrays, states, episodes)
    counts = player.counted_actions(arrays, episodes)[states]
    visited: NDArray[np.bool_] = counts.sum(axis=1) > 0
    walked = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    demonstrated = Demonstrated.of([train])
    twins = Twins.of(arrays, states, demonstrated).joined(Twins.of(arrays, states, others))
    references = [twins.excess(each) for each in references_of(twins, arrays.optimal[states])]

    def measured(actions: NDArray[np.float64], some: NDArray[np.bool_]) -> Excess:
        labyrinth = arrays.labyrinth[states][some]
        parts = [each[:, some] for each in (twins.excess(actions), *references)]
        most = float(mean_of(twins.excess(twins.shown[0])[:1, some])[0])
        return _excess(without_effects(parts[0], parts[1:]), labyrinth, most)

    own_way = measured(walked, visited)
    overall = own_way if actions is None else measured(actions, np.ones(len(states), np.bool_))
    acts = np.where(visited[:, None], walked, np.nan) if actions is None else actions
    return Receipt(
        **vars(overall),
        split=split,
        train=config.to_json(),
        drawn=controls,
        shared=round(shared, 4),
        own_way=own_way,
        everywhere=actions is not None,
        copies=tuple(_copies(twins, acts, arrays, states, demonstrated, own_labyrinths)),
    )


def train_of(data: Dataset, split: str, train_labyrinths: int | None = None) -> TrainSet:
    """Return the train of a dataset, or its first labyrinths, for `receipt_of`.

    Raises:
        ValueError: No other training set could have been that of the split, or its config does not
            draw it.
    """
    config = data.manifest.config
    if split not in SPLITS_WITHOUT_TRAIN:
        raise ValueError(
            f"split={split!r:.60}: give one of {', '.join(SPLITS_WITHOUT_TRAIN)}, "
            "which do not depend on train"
        )
    if config.min_walls > 1:
        raise ValueError(
            f"splits.min_walls={config.min_walls}: {split} was chosen to differ from train, so no "
            "other training set compares with it: give a dataset with splits.min_walls=1"
        )
    if train_labyrinths is not None:
        count = whole("train_labyrinths", train_labyrinths, 1, config.labyrinths)
        config = replace(config, labyrinths=count)
    own = train_set(config)
    if own[1] != list(data["train"].filter(labyrinths=config.labyrinths).labyrinths):
        raise ValueError(
            f"{data.source}/{config.name}: its train is not what its config draws, so other "
            "training sets cannot be drawn like it: build the dataset with this version"
        )
    return own


def _shared(train: TrainSet, hashes: Sequence[frozenset[int]]) -> float:
    """Return the mean share of train that is in controls as well.

    Raises:
        ValueError: It is so large that hardly anything could be found.
    """
    config, labyrinths = train
    mine = frozenset(map(hash, labyrinths))
    shared = float(np.mean([len(mine & each) for each in hashes])) / len(mine)
    if shared > MOST_SHARED:
        raise ValueError(
            f"labyrinths={config.labyrinths}: {shared:.0%} of train is in every other training set "
            f"as well, since {config.name} has few structures: give at most {MOST_SHARED:.0%}, "
            "by fewer labyrinths or train_labyrinths"
        )
    return shared


@lru_cache(maxsize=2)  # Drawing 200 controls takes 5 s at 5x5, all else 2 s.
def _controls(config: DatasetConfig, count: int) -> tuple[Demonstrated, tuple[frozenset[int], ...]]:
    """Return what control training sets demonstrate, and the hashes of their labyrinths."""
    hashes: list[frozenset[int]] = []

    def drawn() -> Iterator[TrainSet]:
        for control, labyrinths in control_sets(config, count):
            if len(labyrinths) < config.labyrinths:
                raise ValueError(
                    f"labyrinths={config.labyrinths}: another training set of {config.name} found "
                    f"only {len(labyrinths)}"
                )
            hashes.append(frozenset(map(hash, labyrinths)))
            yield control, labyrinths

    return Demonstrated.of(drawn()), tuple(hashes)


def references_of(twins: Twins, optimal: NDArray[np.bool_]) -> tuple[NDArray[np.floating], ...]:
    """Return the actions of policies that depend on no single set, for `without_effects`.

    They are the solver, what twins show most often, policies that have learnt other sets, and those
    that always take the same action. In the dataset of seed 0, whose train moves up more often than
    most, a constant policy would otherwise have p = 0.015.
    """
    solver = optimal / np.maximum(optimal.sum(axis=1, keepdims=True), 1)
    usual = np.eye(ACTIONS)[most_shown(np.nansum(twins.shown, axis=0, dtype=np.float64))]
    constant = np.broadcast_to(np.eye(ACTIONS)[:, None], (ACTIONS, *usual.shape))
    return solver, usual, twins.others(), *constant


def _everywhere(
    player: Player, arrays: LabyrinthArrays, states: NDArray[np.int64], episodes: int | None
) -> NDArray[np.float64] | None:
    """Return the share of each action in each state, shape (N, 4); None with memory."""
    if player.reset is not None:
        return None
    if player.forgets and episodes is None:
        player.require_repeatable(arrays)
    taken = np.zeros((len(states), ACTIONS))
    for _ in range(episodes or 1):
        taken[np.arange(len(states)), player.decisions(arrays, states)] += 1
    return taken / (episodes or 1)


def _excess(rest: NDArray[np.float64], labyrinth: NDArray[np.int64], most: float) -> Excess:
    """Return the figures of an excess, shape (sets, N), in states of these labyrinths."""
    means, known = mean_of(rest), ~np.isnan(rest[0])
    at, which = np.unique(labyrinth[known], return_inverse=True)
    parts = np.bincount(which, rest[0, known]) * len(at) / max(int(known.sum()), 1)
    ends = float(parts.min(initial=0)), float(parts.max(initial=0))
    bounds = interval(parts[None], ends=ends) if len(at) else (0.0, 0.0)
    low, high, own, mean, deviation = (
        round(100 * float(each), DECIMALS)
        for each in (*bounds, means[0], means[1:].mean(), means[1:].std(ddof=1))
    )
    as_much = int((means[1:] >= means[0] - EQUAL).sum())
    return Excess(
        excess=own,
        interval=(low, high),
        controls=(mean, deviation),
        p=(1 + as_much) / len(means),
        most=round(100 * most, DECIMALS),
        states=rest.shape[1],
        without_twin=int((~known).sum()),
    )


def _copies(
    twins: Twins,
    actions: NDArray[np.float64],
    arrays: LabyrinthArrays,
    states: NDArray[np.int64],
    demonstrated: Demonstrated,
    own: Sequence[Labyrinth],
) -> Iterator[Copy]:
    """Yield the states with the greatest share in the excess, at most one in each labyrinth."""
    excess = np.nan_to_num(twins.excess(actions)[0])
    seen: set[int] = set()
    for number in np.argsort(-excess, kind="stable").tolist():
        state = states[[number]]
        which = int(arrays.labyrinth[state[0]])
        if len(seen) == COPIES or excess[number] <= 0:
            return
        if which in seen:
            continue
        seen.add(which)
        ((_, candidates, differences),) = compared(arrays, state, demonstrated)
        nearest = np.flatnonzero(differences[0] == differences[0].min())
        labyrinth = arrays.labyrinths[which]
        twin = own[int(demonstrated.labyrinth[candidates[nearest[0]]])]
        seen_state = labyrinth.state_at(int(arrays.state[state[0]]))
        apart = {*labyrinth.structure.passages()} ^ {*twin.structure.passages()}
        did, shown, usual = (
            tuple(round(share, DECIMALS) for share in each.tolist())
            for each in (actions[number], twins.shown[0, number], twins.consensus[0, number])
        )
        yield Copy(
            labyrinth=labyrinth_id(labyrinth),
            agent=seen_state.agent,
            has_key=seen_state.has_key,
            door_open=seen_state.door_open,
            train_labyrinth=labyrinth_id(twin),
            twins=len(nearest),
            differences=int(differences[0].min()),
            passages=tuple(sorted(apart)),
            did=did,
            shown=shown,
            consensus=usual,
            optimal=tuple(arrays.optimal[state[0]].tolist()),
        )
