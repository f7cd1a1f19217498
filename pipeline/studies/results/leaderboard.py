"""The leaderboard: our runs and anybody's results, ranked on the same labyrinths."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from operator import itemgetter
from typing import Any

from labyrinth_core.evaluation.description import Description
from labyrinth_core.world.grid import parse_size
from pipeline.machinery.markdown import count
from pipeline.studies.results.figures import Figures, MethodRuns, run_of
from pipeline.studies.results.kept import AUTHOR, Kept
from pipeline.studies.results.paper import title_of

RANKED_BY = "test"
"""The split whose SPL decides the rank: structures that nobody learns on."""


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
    figures: dict[str, Figures]
    """By split."""
    rank: int | None = None
    """One more than there are entries whose interval of SPL lies above that of this one; None
    without figures on `RANKED_BY`, and for an entry that was not compared."""


def entries_of(methods: Iterable[MethodRuns], kept: Iterable[Kept]) -> Iterator[Entry]:
    """Yield the entries of our runs and of anyone's files.

    Args:
        methods: Our runs.
        kept: The files of these runs, and the results of other policies.
    """
    submissions = [each for each in kept if each.results.run is None]
    compared = {id(each.results) for each in kept if each.compared}
    for each in methods:
        yield _of_runs(each, all(id(results) in compared for results in each.runs))
    yield from map(_of_submission, submissions)


def _of_runs(method: MethodRuns, compared: bool) -> Entry:
    first, run = method.runs[0], run_of(method.runs[0])
    labyrinths = run.train_labyrinths or method.figures["train"].labyrinths
    return Entry(
        config=first.config,
        fingerprint=first.fingerprint,
        method=Description(
            name=title_of(run),
            author=AUTHOR,
            budget=count(run.training["epochs"], "epoch"),
            details={"labyrinths": labyrinths},
        ),
        observation=first.observation,
        seeds=len(method.runs),
        episodes=1,
        version=first.version,
        compared=compared,
        figures=method.figures,
    )


def _of_submission(kept: Kept) -> Entry:
    results = kept.results
    assert results.method is not None  # A file always has it.
    return Entry(
        config=results.config,
        fingerprint=results.fingerprint,
        method=results.method,
        observation=results.observation,
        seeds=1,
        episodes=results.episodes,
        version=results.version,
        compared=kept.compared,
        figures={split: Figures.over([results], split) for split in results.splits},
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
    found = [each.figures.get(RANKED_BY) for each in entries]
    ranked = [each if entry.compared else None for entry, each in zip(entries, found, strict=True)]
    lows = [each.spl_interval[0] for each in ranked if each]
    placed = []
    for entry, figures, mine in zip(entries, found, ranked, strict=True):
        rank = 1 + sum(low > mine.spl_interval[1] for low in lows) if mine else None
        spl = figures.spl if figures else -1.0
        placed.append(
            ((rank is None, rank or 0, -spl, entry.method.name), replace(entry, rank=rank))
        )
    return [entry for _, entry in sorted(placed, key=itemgetter(0))]
