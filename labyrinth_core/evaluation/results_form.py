"""What is checked of results: the form of their file, their figures, and their dataset.

The file may come from anyone. Its figures have to follow from its episodes; labyrinths, known
routes and baselines are compared with those computed from the rows of the dataset. A consistent
file can still be invented: only playing the policy again shows that it is not.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from labyrinth_core import typed
from labyrinth_core.data import Dataset, DatasetConfig
from labyrinth_core.evaluation.baselines import BLIND, WITHOUT_LEARNING, TrainMemory
from labyrinth_core.evaluation.description import (
    ConfigName,
    Description,
    Judgement,
    Origin,
    SplitName,
    TrainedRun,
)
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.memorised import Receipt
from labyrinth_core.evaluation.replanner import replan
from labyrinth_core.evaluation.scores import Episodes, Scores
from labyrinth_core.pictures import OBSERVATIONS, ObservationSpec

_EXACT = 1e-12
"""Figures that differ by no more than this are equal; another processor may round the last of their
sixteen digits differently."""

_CLOSE = 1e-9
"""Figures of a baseline that differ by no more than this are equal; another processor may sum many
probabilities in another order."""


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
        lists = {name: getattr(self, name) for name in ("labyrinth_ids", "distance", "known_route")}
        for name in ("outcomes", "moves"):
            rows = getattr(self, name)
            if len(rows) != episodes:
                raise ValueError(f"{name} has {len(rows)} rows, not {episodes} as episodes")
            lists |= {f"{name}[{number}]": row for number, row in enumerate(rows)}
        for name, each in lists.items():
            if len(each) != self.labyrinths:
                raise ValueError(f"{name} has {len(each)} entries, not {self.labyrinths}")
        if len({*self.labyrinth_ids}) < self.labyrinths:
            raise ValueError("labyrinth_ids has a labyrinth twice")
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
            claimed, inside = getattr(self, name), name.removesuffix("_interval")
            if name == inside:
                follows, told = _equal(claimed, right), f"but {right} follows from the outcomes"
            else:  # An earlier version resampled, so its intervals are not these.
                figure = getattr(self, inside)
                follows = claimed[0] - _EXACT <= figure <= claimed[1] + _EXACT
                told = f"which is not around {inside}={figure}"
            if not follows:
                raise ValueError(f"{name} is {claimed!r:.60}, {told}")
        return scores


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


@dataclass(frozen=True, eq=False)
class KnownSplit:
    """The L labyrinths of a split, or its first L, with routes and baselines computed from them."""

    dataset: str
    """The name of the dataset, for messages."""
    labyrinth_ids: NDArray[np.int64]
    """The id of each labyrinth, shape (L,)."""
    distance: NDArray[np.int64]
    """Moves on a shortest route, shape (L,)."""
    known_route: NDArray[np.bool_]
    """As in `Scores`, shape (L,)."""
    baselines: Mapping[str, Mapping[str, float]]
    """Baseline -> its figures."""

    @classmethod
    def of(cls, dataset: str, arrays: LabyrinthArrays, memory: TrainMemory) -> KnownSplit:
        """Compute the properties of a split that is observed as vectors."""
        known, baselines = memory.figures(arrays, blind=True)
        if arrays.labyrinths[0].task.rules.hides:
            baselines |= replan(arrays)
        return cls(dataset, arrays.labyrinth_ids, arrays.distance, known, baselines)

    def require_same(
        self, scores: Scores, baselines: Mapping[str, Mapping[str, float]], *, blind: bool
    ) -> None:
        """Compare results with the labyrinths of the split, and with its baselines.

        Args:
            scores: The scores of a policy.
            baselines: Baseline -> its figures.
            blind: Whether the baselines in `BLIND` are required.

        Raises:
            ValueError: Something differs; the message names it.
        """
        if len(scores.distance) != len(self.distance):
            raise ValueError(
                f"{len(scores.distance)} labyrinths, but {self.dataset} has {len(self.distance)}"
            )
        for name, form in (
            ("labyrinth_ids", "{:016x}"),
            ("distance", "{}"),
            ("known_route", "{:d}"),
        ):
            claimed, right = getattr(scores, name), getattr(self, name)
            for number in np.flatnonzero(claimed != right)[:1]:
                told, known = form.format(claimed[number]), form.format(right[number])
                raise ValueError(f"{name}[{number}] is {told}, but {known} in {self.dataset}")
        for name, figures in self.baselines.items():
            if name not in baselines and (blind or name not in BLIND):
                raise ValueError(f"the figures of the baseline {name} are missing")
            for figure, value in baselines.get(name, {}).items():
                if abs(value - figures[figure]) > _CLOSE:
                    raise ValueError(
                        f"{figure} of {name} is {value}, but {figures[figure]} in {self.dataset}"
                    )


@dataclass(frozen=True, eq=False)
class KnownDataset:
    """A dataset in a folder or on the Hub; each split is read when it is first requested."""

    data: Dataset
    _memories: dict[int | None, TrainMemory] = field(default_factory=dict)
    _splits: dict[tuple[str, int | None], KnownSplit] = field(default_factory=dict)

    @classmethod
    def read(cls, source: str, config: str, revision: str | None = None) -> KnownDataset:
        """Return a dataset by its folder or its id on the Hub; see `Dataset`."""
        return cls(Dataset(source, config, revision))

    @property
    def name(self) -> str:
        """The folder, or the id on the Hub, and the config."""
        return f"{self.data.source}/{self.data.config}"

    @property
    def fingerprint(self) -> str:
        """The fingerprint of the dataset's rows."""
        return self.data.fingerprint

    def split(self, name: str, learnt: int | None = None) -> KnownSplit:
        """Return a split's labyrinths, routes and baselines, computed from the dataset.

        Args:
            name: The name of the split.
            learnt: The number of labyrinths, the first of train, that a policy learnt from; the
                references know only these, and it is judged only on these. None for all.

        Raises:
            ValueError: The dataset has no such split.
            DatasetError: The rows of the split cannot be read.
        """
        if name not in self.data.splits:
            raise ValueError(f"{name}: {self.name} has no such split")

        def load(split: str) -> LabyrinthArrays:
            selection = self.data.of_first(split, learnt)
            return LabyrinthArrays.of(selection, ObservationSpec("vector"), hold=False)

        if (name, learnt) not in self._splits:
            if learnt not in self._memories:
                self._memories[learnt] = TrainMemory.of(load("train"))
            known = KnownSplit.of(self.name, load(name), self._memories[learnt])
            self._splits[name, learnt] = known
        return self._splits[name, learnt]
