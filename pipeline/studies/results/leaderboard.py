"""The leaderboard: our runs and anybody's results, ranked on the same labyrinths."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np

from labyrinth_core.evaluation.description import Description
from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.evaluation.results import Results
from labyrinth_core.world.grid import parse_size
from pipeline.machinery.markdown import count
from pipeline.studies.results.figures import BY_METHOD, Figures, by_method, run_of
from pipeline.studies.results.kept import AUTHOR, Kept
from pipeline.studies.results.paper import title_of

RANKED_BY = "test"
"""The split whose SPL decides the rank: structures that nobody learns on."""


@dataclass(frozen=True)
class Standing:
    """The figures of a method on a split."""

    labyrinths: int
    spl: float
    spl_interval: tuple[float, float]
    sr_within_cells: float
    sr: float
    sr_interval: tuple[float, float]
    aer: float
    aer_std: float
    aer_interval: tuple[float, float]
    path_efficiency: float | None


@dataclass(frozen=True)
class Entry:
    """A method on the leaderboard of a dataset."""

    config: str
    fingerprint: str
    """The fingerprint of the dataset's rows."""
    method: Description
    observation: str
    """What the policy is shown."""
    seeds: int
    """The number of times that it was trained."""
    episodes: int
    """The number of episodes in each labyrinth."""
    version: str
    """The version of the software that evaluated it, empty if it is not stated."""
    compared: bool
    """Whether the dataset was available, so that all that it settles was checked."""
    standings: dict[str, Standing]
    """The figures by split."""
    rank: int | None = None
    """One more than there are entries whose interval of SPL lies above that of this one; None
    without figures on `RANKED_BY`, and for an entry that was not compared."""


def entries_of(
    runs: Sequence[Kept], figures: Sequence[Figures], submissions: Iterable[Kept]
) -> Iterator[Entry]:
    """Yield the entries of our runs and of anyone's files.

    Args:
        runs: Our runs, in the usual order.
        figures: Their figures over seeds, likewise.
        submissions: The results of other policies.
    """
    compared = {id(each.results): each.compared for each in runs}
    groups = by_method([each.results for each in runs])
    for group, (_, found) in zip(groups, groupby(figures, BY_METHOD), strict=True):
        yield _of_runs(group, list(found), all(compared[id(each)] for each in group))
    yield from map(_of_submission, submissions)


def _of_runs(group: Sequence[Results], figures: Iterable[Figures], compared: bool) -> Entry:
    """Return the entry of runs that differ in their seed alone."""
    first, run = group[0], run_of(group[0])
    counts = {split: len(scores.distance) for split, scores in first.splits.items()}
    return Entry(
        config=first.config,
        fingerprint=first.fingerprint,
        method=Description(
            name=title_of(run),
            author=AUTHOR,
            budget=count(run.training["epochs"], "epoch"),
            details={"labyrinths": run.train_labyrinths or counts["train"]},
        ),
        observation=first.observation,
        seeds=len(group),
        episodes=1,
        version=first.version,
        compared=compared,
        standings={
            each.split: Standing(
                labyrinths=counts[each.split],
                spl=each.spl,
                spl_interval=each.spl_interval,
                sr_within_cells=each.sr_within_cells,
                sr=each.sr,
                sr_interval=each.sr_interval,
                aer=each.aer,
                aer_std=each.aer_std,
                aer_interval=each.aer_interval,
                path_efficiency=each.averages["path_efficiency"],
            )
            for each in figures
        },
    )


def _of_submission(kept: Kept) -> Entry:
    results = kept.results
    assert results.method is not None  # A file always has it.
    names = [each.name for each in fields(Standing)]
    figures = {
        split: scores.figures() | {"spl_interval": interval(np.atleast_2d(scores.weighted))}
        for split, scores in results.splits.items()
    }
    return Entry(
        config=results.config,
        fingerprint=results.fingerprint,
        method=results.method,
        observation=results.observation,
        seeds=1,
        episodes=results.episodes,
        version=results.version,
        compared=kept.compared,
        standings={
            split: Standing(**{name: each[name] for name in names})
            for split, each in figures.items()
        },
    )


def boards(entries: Iterable[Entry]) -> list[list[Entry]]:
    """Return the entries of each dataset, the smallest labyrinths first, ranked and in order."""

    def dataset(entry: Entry) -> tuple[Any, ...]:
        size = parse_size(entry.config.partition("-")[0])
        return size, entry.config, entry.fingerprint

    groups = groupby(sorted(entries, key=dataset), dataset)
    return [_ranked(list(group)) for _, group in groups]


def _ranked(entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries of one dataset with their ranks, in order."""
    found = [each.standings.get(RANKED_BY) for each in entries]
    ranked = [each if entry.compared else None for entry, each in zip(entries, found, strict=True)]
    lows = [each.spl_interval[0] for each in ranked if each]
    placed = []
    for entry, standing, mine in zip(entries, found, ranked, strict=True):
        rank = 1 + sum(low > mine.spl_interval[1] for low in lows) if mine else None
        spl = standing.spl if standing else -1.0
        placed.append(
            ((rank is None, rank or 0, -spl, entry.method.name), replace(entry, rank=rank))
        )
    return [entry for _, entry in sorted(placed, key=itemgetter(0))]
