"""The form of a results file, whose figures have to follow from its episodes.

The file may come from anyone. A consistent file can still be invented: only playing the policy
again shows that it is not (`replaying`).
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Annotated, Any, Literal

import numpy as np

from labyrinth_core import typed
from labyrinth_core.data import DatasetConfig
from labyrinth_core.evaluation.baselines import WITHOUT_LEARNING
from labyrinth_core.evaluation.description import (
    ConfigName,
    Description,
    Judgement,
    Origin,
    SplitName,
    TrainedRun,
)
from labyrinth_core.evaluation.memorised import Receipt
from labyrinth_core.evaluation.scores import Episodes, Scores
from labyrinth_core.pictures import OBSERVATIONS
from labyrinth_core.world import Action

KIND = "labyrinth-results"
FORMAT = 2

INTERVALS = {"sr_interval": "sr", "aer_interval": "aer"}
"""Interval -> its figure. Those in a file may be of an earlier version, which resampled."""

_EXACT = 1e-12
"""Figures that differ by no more than this are equal; another processor may round the last of their
sixteen digits differently."""


@dataclass(frozen=True)
class Figures:
    """The figures of a baseline on a split."""

    sr: typed.Share
    sr_within_cells: typed.Share
    spl: typed.Share
    aer: float
    aer_std: float


@dataclass(frozen=True)
class Played:
    """The results on a split: the episodes, and the figures that follow from them."""

    labyrinths: typed.Positive
    sr: float
    sr_within_cells: float
    spl: float
    aer: float
    aer_std: float
    sr_known_route: float | None
    sr_new_route: float | None
    known_route: Annotated[str, typed.Like("[01]*")]
    path_efficiency: float | None
    accuracy_on_demonstrations: typed.Share | None
    accuracy_elsewhere: typed.Share | None
    failures: Mapping[str, typed.Count]
    sr_interval: tuple[float, float]
    aer_interval: tuple[float, float]
    labyrinth_ids: tuple[typed.LabyrinthId, ...]
    distance: tuple[typed.Positive, ...]
    step_limit: int
    outcomes: tuple[Annotated[str, typed.Like("[slwi]*")], ...]
    moves: tuple[tuple[typed.Positive, ...], ...]

    def scores(self, cells: int, episodes: int) -> Scores:
        """Return the scores of the episodes, after comparing the figures with them.

        Args:
            cells: The number of cells of a labyrinth.
            episodes: The number of episodes in each labyrinth.

        Raises:
            ValueError: A list has another length, an episode is impossible, or a figure does not
                follow; the message names it.
        """
        self._require_lengths(episodes)
        played = Episodes.of_letters(self.outcomes, self.moves, cells)
        scores = Scores(
            played,
            np.array([int(each, 16) for each in self.labyrinth_ids], np.int64),
            np.array(self.distance, np.int64),
            self.accuracy_on_demonstrations,
            self.accuracy_elsewhere,
            known_route=np.array([mark == "1" for mark in self.known_route]),
        )
        limit, moves, solved = played.step_limit, played.moves, played.solved
        for wrong, what in (
            (solved & (moves < scores.distance), "a solution of fewer moves than a shortest route"),
            (moves > limit, f"more moves than the limit of {limit}"),
            (~solved & (played.outcomes != "ice") & (moves < limit), "a failure before the limit"),
        ):
            for episode, number in np.argwhere(wrong)[:1].tolist():
                raise ValueError(
                    f"moves[{episode}][{number}] is {moves[episode, number]}: labyrinth "
                    f"{self.labyrinth_ids[number]} has {what}"
                )
        for name, right in (scores.figures() | {"step_limit": limit}).items():
            claimed = getattr(self, name)
            if name not in INTERVALS:
                follows, told = _equal(claimed, right), f"but {right} follows from the outcomes"
            else:
                figure = getattr(self, INTERVALS[name])
                follows = claimed[0] - _EXACT <= figure <= claimed[1] + _EXACT
                told = f"which is not around {INTERVALS[name]}={figure}"
            if not follows:
                raise ValueError(f"{name} is {claimed!r:.60}, {told}")
        return scores

    def _require_lengths(self, episodes: int) -> None:
        """Raise ValueError unless each list has one entry for each labyrinth."""
        lists: list[tuple[str, Any]] = [
            (name, getattr(self, name)) for name in ("labyrinth_ids", "distance", "known_route")
        ]
        for name in ("outcomes", "moves"):
            rows = getattr(self, name)
            if len(rows) != episodes:
                raise ValueError(f"{name} has {len(rows)} rows, not {episodes} as episodes")
            lists += [(f"{name}[{number}]", row) for number, row in enumerate(rows)]
        for name, each in lists:
            if len(each) != self.labyrinths:
                raise ValueError(f"{name} has {len(each)} entries, not {self.labyrinths}")
        if len({*self.labyrinth_ids}) < self.labyrinths:
            raise ValueError("labyrinth_ids has a labyrinth twice")


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, float | int) and isinstance(other, float | int):
        return abs(one - other) <= _EXACT
    return bool(one == other)


@dataclass(frozen=True)
class DatasetName:
    """The dataset that a policy was evaluated on; see `Results`."""

    source: str
    revision: str | None
    config: ConfigName
    fingerprint: typed.Sha256


@dataclass(frozen=True)
class Evaluated:
    """How a policy was evaluated; see `Results`."""

    observation: Annotated[str, typed.Like("|".join(OBSERVATIONS))]
    image_size: typed.Positive | None
    way: Literal["look-ups", "steps"]
    episodes: Annotated[int, typed.Within(1, typed.MOST_EPISODES)]
    seed: typed.Seed
    version: Annotated[str, typed.Like(r"[\w.+-]{1,50}")]


_Baseline = Annotated[str, typed.Like("|".join(WITHOUT_LEARNING))]


@dataclass(frozen=True)
class ResultsFile:
    """A results file, as `Results.save` writes it."""

    kind: Literal["labyrinth-results"]
    format: Literal[2]
    method: Description
    dataset: DatasetName
    evaluated: Evaluated
    splits: Mapping[SplitName, Played]
    baselines: Mapping[_Baseline, Mapping[SplitName, Figures]]
    run: TrainedRun | None = None
    judged: Judgement | None = None
    policy: Origin | None = None
    memorised: Receipt | None = None

    def __post_init__(self) -> None:
        run, evaluated = self.run, self.evaluated
        if run is not None and (self.method.name, evaluated.seed) != (run.name, run.seed):
            raise ValueError(
                f"it is of {self.method.name!r:.60}, seed {evaluated.seed}, but its run is "
                f"{run.name}"
            )
        if evaluated.way == "look-ups" and evaluated.episodes != 1:
            raise ValueError(f"episodes={evaluated.episodes}: look-ups give one in each labyrinth")


def check_receipt(receipt: Receipt, splits: Container[str], cells: int) -> None:
    """Raise ValueError if a receipt cannot be of the splits of labyrinths with so many cells.

    Without the policy its figures cannot be computed again.
    """
    if receipt.split not in splits:
        raise ValueError(f"it.memorised.split is {receipt.split}, which has no results")
    if (train := DatasetConfig.from_json(receipt.train)).height * train.width != cells:
        raise ValueError(f"it.memorised.train is of {train.name}, not of {cells} cells")
    for each in (receipt, receipt.own_way):
        rank = each.p * (1 + receipt.drawn)
        if abs(rank - round(rank)) > 1e-6 or rank < 0.5:
            raise ValueError(f"it.memorised: p={each.p} is no rank among {receipt.drawn}")
    for copy in receipt.copies:
        for cell in (copy.agent, *chain.from_iterable(copy.passages)):
            if cell >= cells:
                raise ValueError(f"it.memorised: a copy is in cell {cell} of {cells}")
        for shares in (copy.did, copy.shown, copy.consensus, copy.optimal):
            if len(shares) != len(Action):
                raise ValueError(
                    f"it.memorised: a copy has {len(shares)} actions, not {len(Action)}"
                )
