"""Evaluations as they are kept in files, and their figures over seeds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.splits import SHIFTS
from labyrinth_core.evaluation.following import Episodes
from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS, episodes_of
from labyrinth_core.world.grid import parse_size
from pipeline.machinery.evaluation_file import check_evaluation
from pipeline.machinery.schema import read_json
from pipeline.studies.results.paper import METHODS

FAILURES = ("loop", "wall", "ice")
AVERAGED = (
    "sr_within_cells",
    "spl",
    "sr_known_route",
    "sr_new_route",
    "path_efficiency",
    "accuracy_on_demonstrations",
    "accuracy_elsewhere",
)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The evaluation of one run, as it was read."""

    path: Path
    config: str
    """The config of the dataset, such as `5x5`."""
    setup: str
    """All other choices but the seed, such as `cnn` or `resnet18-paper`."""
    method: str
    seed: int
    episodes: dict[str, Episodes]
    """The episodes of each split."""
    content: dict[str, Any]


BY_METHOD = attrgetter("config", "setup", "method")


@dataclass(frozen=True)
class Figures:
    """The figures of a method on a split, over its seeds."""

    config: str
    setup: str
    method: str
    split: str
    seeds: int
    sr: float
    sr_interval: tuple[float, float]
    """The interval over seeds and labyrinths."""
    aer: float
    aer_std: float
    """The standard deviation over labyrinths, averaged over seeds."""
    aer_interval: tuple[float, float]
    failures: dict[str, float]
    """The share of all labyrinths with each of `FAILURES`."""
    averages: dict[str, float | None]
    """The mean of each of `AVERAGED`; None if it is not defined for any seed."""
    by_distance: dict[int, str]
    """By moves on a shortest route: how many episodes succeed, such as `3 of 5`."""


def read_all(results_dir: Path) -> list[Evaluation]:
    """Return the evaluations that are kept, by config, setup, method and seed.

    Raises:
        DatasetError: One cannot be read, two of the same config are of different datasets, or two
            seeds of one method have different settings.
    """
    found = [read(path) for path in sorted((results_dir / "runs").glob("*/*.json"))]
    first: dict[object, Evaluation] = {}
    for each in found:
        other = first.setdefault(each.config, each)
        if _labyrinths(other) != _labyrinths(each):
            raise DatasetError(
                f"{each.path} and {other.path} are of different datasets, and not to be compared: "
                "remove one, or choose another results_dir"
            )
        other = first.setdefault(BY_METHOD(each), each)
        mine, others = each.content["run"]["settings"], other.content["run"]["settings"]
        # Settings that only one of them has are newer, and have no effect by default.
        common = [name for name in mine if name in others and mine[name] != others[name]]
        if common:
            differing = ", ".join(f"{name}={mine[name]} and {others[name]}" for name in common)
            raise DatasetError(
                f"{each.path} and {other.path} are of different settings, {differing}, and not to "
                "be averaged: remove one, or choose another results_dir"
            )

    def order(each: Evaluation) -> tuple[Any, ...]:
        place = [*METHODS, each.method].index(each.method)
        return each.config, each.setup, place, each.method, each.seed

    return sorted(found, key=order)


def _labyrinths(evaluation: Evaluation) -> tuple[Any, ...]:
    """Return what tells on which labyrinths a run was evaluated."""
    splits = evaluation.content["splits"]
    distances = [
        {moves: count for moves, (_, count) in splits[split]["by_distance"].items()}
        for split in EVALUATED_SPLITS
    ]
    return evaluation.content["run"]["fingerprint"], distances


def read(path: Path) -> Evaluation:
    """Return the evaluation in a file.

    Raises:
        DatasetError: The file cannot be read, or holds no evaluation.
    """
    try:
        content = read_json(path)
        check_evaluation(content)
        about, splits = content["run"], content["splits"]
        setup = [about["encoder"]]
        setup += [f"stride{about['pool_stride']}"] * (about["pool_stride"] != 1)
        setup += [about["protocol"]] * (about["protocol"] != "default")
        if "precision" in about:
            setup.append(about["precision"])
        setup += ["memory"] * bool(about.get("memory"))
        if about.get("train_labyrinths") is not None:
            setup.append(f"labyrinths{int(about['train_labyrinths'])}")
        height, width = parse_size(about["config"].partition("-")[0])
        episodes = {name: episodes_of(splits[name], height * width) for name in splits}
        for name, found in episodes.items():
            splits[name] = _recomputed(splits[name], found) | splits[name]
        return Evaluation(
            path=path,
            config=about["config"],
            setup="-".join(setup),
            method=about["method"],
            seed=about["seed"],
            episodes=episodes,
            content=content,
        )
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{path} cannot be read: {one_line(error):.300}") from error


def _recomputed(scores: Mapping[str, Any], episodes: Episodes) -> dict[str, float]:
    """Return figures that older files do not have, as far as they follow from what these have."""
    within = episodes.solved & (episodes.moves <= episodes.cells)
    spl = scores["sr"] * (scores["path_efficiency"] or 0)
    return {"sr_within_cells": float(within.mean()), "spl": spl}


def summarise(evaluations: Sequence[Evaluation]) -> list[Figures]:
    """Return the figures of each method, setup and split, for evaluations in the usual order."""
    groups = [list(group) for _, group in groupby(evaluations, BY_METHOD)]
    return [_over_seeds(group, split) for group in groups for split in _splits_of(group)]


def _splits_of(group: Sequence[Evaluation]) -> list[str]:
    """Return the splits that all of some runs were evaluated on: the usual ones, then shifts."""
    shared = set.intersection(*(set(each.episodes) for each in group))
    return [*EVALUATED_SPLITS, *(shift for shift in SHIFTS if shift in shared)]


def _over_seeds(group: Sequence[Evaluation], split: str) -> Figures:
    told = [each.content["splits"][split] for each in group]
    solved = solved_in(group, split)
    returns = np.stack([each.episodes[split].returns for each in group])
    outcomes = np.stack([each.episodes[split].outcomes for each in group])
    return Figures(
        config=group[0].config,
        setup=group[0].setup,
        method=group[0].method,
        split=split,
        seeds=len(group),
        sr=float(solved.mean()),
        sr_interval=interval(solved),
        aer=float(returns.mean()),
        aer_std=float(returns.std(axis=1).mean()),
        aer_interval=interval(returns),
        failures={name: float((outcomes == name).mean()) for name in FAILURES},
        averages={name: _mean(each.get(name) for each in told) for name in AVERAGED},
        by_distance={
            int(moves): f"{sum(e['by_distance'][moves][0] for e in told)} of {len(told) * count}"
            for moves, (_, count) in told[0]["by_distance"].items()
        },
    )


def gap(group: Sequence[Evaluation]) -> tuple[float, float, float]:
    """Return the difference of the SR on train and on test, over seeds, and its interval."""
    train, test = (solved_in(group, split) for split in ("train", "test"))
    return float(train.mean() - test.mean()), *interval(train, test)


def solved_in(group: Sequence[Evaluation], split: str) -> NDArray[np.float64]:
    """Return 1 for each labyrinth that was solved, else 0, shape (seeds, labyrinths)."""
    return np.stack([each.episodes[split].solved for each in group]).astype(np.float64)


def _mean(values: Iterable[float | None]) -> float | None:
    defined = [value for value in values if value is not None]
    return sum(defined) / len(defined) if defined else None
