"""The leaderboard: our runs and anybody's results, ranked on the same labyrinths."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import groupby
from operator import itemgetter
from typing import Any

from labyrinth_core.evaluation.description import Description
from labyrinth_core.world.grid import parse_size
from pipeline.machinery.markdown import count
from pipeline.studies.results.evaluations import BY_METHOD, Evaluation, Figures
from pipeline.studies.results.paper import METHODS
from pipeline.studies.results.submissions import Submission

RANKED_BY = "test"
"""The split whose SR decides the rank: structures that nobody learns on."""

AUTHOR = "Labyrinth datasets"
"""Who made the runs of the stages `train` and `evaluate`."""


@dataclass(frozen=True)
class Standing:
    """The figures of a method on a split."""

    labyrinths: int
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
    """Whether its labyrinths are known to be those of the dataset."""
    standings: dict[str, Standing]
    """The figures by split."""
    rank: int | None = None
    """One more than there are entries whose interval lies above that of this one; None without
    figures on `RANKED_BY`."""


def entries_of(
    evaluations: Sequence[Evaluation], figures: Sequence[Figures], submissions: Iterable[Submission]
) -> Iterator[Entry]:
    """Yield the entries of our runs, which have a figure for each split, and of anybody's files.

    Args:
        evaluations: Our runs, in the usual order.
        figures: Their figures over seeds, likewise.
        submissions: The files.
    """
    by_method = zip(groupby(evaluations, BY_METHOD), groupby(figures, BY_METHOD), strict=True)
    for (_, runs), (_, told) in by_method:
        yield _of_runs(list(runs), told)
    yield from map(_of_submission, submissions)


def _of_runs(runs: Sequence[Evaluation], figures: Iterable[Figures]) -> Entry:
    """Return the entry of runs that differ in their seed alone."""
    first = runs[0]
    about, splits = first.content["run"], first.content["splits"]
    name = METHODS.get(first.method, first.method)
    return Entry(
        config=first.config,
        fingerprint=about["fingerprint"],
        method=Description(
            name=name if first.setup == first.method else f"{name}, {first.setup}",
            author=AUTHOR,
            budget=count(first.content["training"]["epochs"], "epoch"),
            details={
                "labyrinths": int(about.get("train_labyrinths") or splits["train"]["labyrinths"])
            },
        ),
        observation=_text_in(about, "observation"),
        seeds=len(runs),
        episodes=1,
        version=_text_in(first.content, "evaluated", "versions", "labyrinth-datasets"),
        compared=True,
        standings={
            each.split: Standing(
                labyrinths=splits[each.split]["labyrinths"],
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


def _of_submission(submission: Submission) -> Entry:
    told = submission.evaluated
    figures = {split: scores.figures() for split, scores in submission.scores.items()}
    names = [each.name for each in fields(Standing)]
    return Entry(
        config=submission.config,
        fingerprint=submission.fingerprint,
        method=submission.method,
        observation=told["observation"],
        seeds=1,
        episodes=told["episodes"],
        version=told["version"],
        compared=submission.compared,
        standings={
            split: Standing(**{name: each[name] for name in names})
            for split, each in figures.items()
        },
    )


def _text_in(content: Any, *names: str) -> str:
    """Return the text at a place in JSON that need not be there, empty if there is none."""
    for name in names:
        content = content.get(name) if isinstance(content, dict) else None
    return content if isinstance(content, str) else ""


def boards(entries: Iterable[Entry]) -> list[list[Entry]]:
    """Return the entries of each dataset, the smallest labyrinths first, ranked and in order."""

    def dataset(entry: Entry) -> tuple[Any, ...]:
        size = parse_size(entry.config.partition("-")[0])
        return size, entry.config, entry.fingerprint

    groups = groupby(sorted(entries, key=dataset), dataset)
    return [_ranked(list(group)) for _, group in groups]


def _ranked(entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries of one dataset with their ranks, in order."""
    standings = [each.standings.get(RANKED_BY) for each in entries]
    lows = [standing.sr_interval[0] for standing in standings if standing]
    placed = []
    for entry, mine in zip(entries, standings, strict=True):
        rank = 1 + sum(low > mine.sr_interval[1] for low in lows) if mine else None
        order = (rank is None, rank or 0, -mine.sr if mine else 0, entry.method.name)
        placed.append((order, replace(entry, rank=rank)))
    return [entry for _, entry in sorted(placed, key=itemgetter(0))]
