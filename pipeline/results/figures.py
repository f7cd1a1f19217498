"""Aggregate results: the figures of a method over its seeds, or of a single policy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.splits import SHIFTS
from labyrinth_core.evaluation.description import TrainedRun
from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.evaluation.results import Results
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS

FAILURES = ("loop", "wall", "ice")
AVERAGED = (
    "sr_known_route",
    "sr_new_route",
    "path_efficiency",
    "accuracy_on_demonstrations",
    "accuracy_elsewhere",
)
"""Figures of `Scores` that are averaged over seeds."""


def run_of(results: Results) -> TrainedRun:
    """Return the run that trained the evaluated policy; the results have to be of a run."""
    assert results.run is not None  # Results of other policies are kept separately.
    return results.run


@dataclass(frozen=True)
class Figures:
    """The figures on a split, over the seeds of a method."""

    labyrinths: int
    spl: float
    spl_interval: tuple[float, float]
    sr_within_cells: float
    sr: float
    sr_interval: tuple[float, float]
    """The interval over seeds and labyrinths."""
    aer: float
    aer_std: float
    """The standard deviation over labyrinths, averaged over seeds."""
    aer_interval: tuple[float, float]
    failures: dict[str, float]
    """For each of `FAILURES`, its share of all labyrinths."""
    averages: dict[str, float | None]
    """The mean of each of `AVERAGED`; None if no seed defines it."""
    by_distance: dict[int, str]
    """Length of the shortest route -> how many episodes succeed, such as `3 of 5`."""

    @classmethod
    def over(cls, group: Sequence[Results], split: str) -> Figures:
        """Aggregate results that differ only in their seed; one is enough."""
        scores = [each.splits[split] for each in group]
        solved = solved_in(group, split)
        weighted = np.concatenate([np.atleast_2d(each.weighted) for each in scores])
        returns = np.concatenate([np.atleast_2d(each.episodes.returns) for each in scores])
        outcomes = np.concatenate([np.atleast_2d(each.episodes.outcomes) for each in scores])
        counted = [each.by_distance for each in scores]
        return cls(
            labyrinths=len(scores[0].distance),
            spl=sum(each.spl for each in scores) / len(scores),
            spl_interval=interval(weighted),
            sr_within_cells=sum(each.sr_within_cells for each in scores) / len(scores),
            sr=float(solved.mean()),
            sr_interval=interval(solved),
            aer=float(returns.mean()),
            aer_std=float(np.mean([each.episodes.returns.std() for each in scores])),
            aer_interval=interval(returns),
            failures={name: float((outcomes == name).mean()) for name in FAILURES},
            averages={name: _mean(getattr(each, name) for each in scores) for name in AVERAGED},
            by_distance={
                moves: " of ".join(
                    str(sum(each[moves][part] for each in counted)) for part in (0, 1)
                )
                for moves in counted[0]
            },
        )

    def columns(self) -> dict[str, object]:
        """Return the figures by column name, with intervals as two columns."""
        values = asdict(self) | self.failures | self.averages
        for name in ("spl", "sr", "aer"):
            values[f"{name}_low"], values[f"{name}_high"] = values[f"{name}_interval"]
        lengths = self.by_distance.items()
        return values | {"by_distance": "; ".join(f"{moves}: {won}" for moves, won in lengths)}


@dataclass(frozen=True, eq=False)
class MethodRuns:
    """The runs of a method on a dataset, which differ only in their seed."""

    runs: Sequence[Results]
    figures: dict[str, Figures]
    """Split -> its figures: the usual splits, then the shifts that all runs were evaluated on."""

    @property
    def config(self) -> str:
        """The config of the dataset, such as `5x5`."""
        return self.runs[0].config

    @property
    def setup(self) -> str:
        """All choices besides method and seed, such as `cnn` or `resnet18-paper`."""
        return run_of(self.runs[0]).setup

    @property
    def method(self) -> str:
        """Such as `bc`."""
        return run_of(self.runs[0]).method


def by_method(results: Sequence[Results]) -> list[MethodRuns]:
    """Group runs by config, setup and method; `results` have to be in the order of these."""

    def key(each: Results) -> tuple[str, str]:
        return each.config, run_of(each).of_all_seeds

    found = []
    for group in (list(group) for _, group in groupby(results, key)):
        shared = set.intersection(*(set(each.splits) for each in group))
        splits = [*EVALUATED_SPLITS, *(shift for shift in SHIFTS if shift in shared)]
        found.append(MethodRuns(group, {split: Figures.over(group, split) for split in splits}))
    return found


def gap(group: Sequence[Results]) -> tuple[float, float, float]:
    """Return the SR on train minus the SR on test, over seeds, with its interval."""
    train, test = (solved_in(group, split) for split in ("train", "test"))
    return float(train.mean() - test.mean()), *interval(train, test)


def solved_in(group: Sequence[Results], split: str) -> NDArray[np.float64]:
    """Return 1 for each solved labyrinth, else 0, shape (seeds, labyrinths)."""
    solved = [np.atleast_2d(each.splits[split].episodes.solved) for each in group]
    return np.concatenate(solved).astype(np.float64)


def _mean(values: Iterable[float | None]) -> float | None:
    defined = [value for value in values if value is not None]
    return sum(defined) / len(defined) if defined else None
