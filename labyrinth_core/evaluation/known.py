"""Recompute a dataset's labyrinths, known routes and baselines, to check results against them.

Labyrinths, known routes and baselines in a results file are not trusted: they are compared with
those computed from the rows of the dataset.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import Dataset
from labyrinth_core.evaluation.baselines import BLIND, TrainMemory
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.replanner import replan
from labyrinth_core.evaluation.scores import Scores
from labyrinth_core.pictures import ObservationSpec

_CLOSE = 1e-9
"""Figures of a baseline that differ by no more than this are equal; another processor may sum many
probabilities in another order."""


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
