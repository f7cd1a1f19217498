"""Evaluations as they are kept in files, and what they amount to over seeds."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.evaluation.following import OUTCOMES
from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS, episodes_of
from labyrinth_core.world.grid import parse_size
from pipeline.training.results.paper import METHODS

EVALUATION = "evaluation.json"
"""Name of the file that an evaluation leaves in the folder of its run."""

FORMAT = 1


@dataclass(frozen=True)
class Evaluation:
    """One run's evaluation as it was read."""

    path: Path
    config: str
    """Of the dataset, such as `5x5`."""
    method: str
    setup: str
    """All else that was chosen but for the seed, such as `cnn` or `resnet18-paper`."""
    seed: int
    fingerprint: str
    """Of the dataset."""
    settings: dict[str, Any]
    """Of the method."""
    content: dict[str, Any]


@dataclass(frozen=True)
class Figures:
    """What a method achieved on a split, over its seeds."""

    config: str
    setup: str
    method: str
    split: str
    seeds: int
    sr: float
    sr_interval: tuple[float, float]
    """Over seeds and labyrinths."""
    aer: float
    aer_std: float
    """Over labyrinths, the mean of the seeds'."""
    aer_interval: tuple[float, float]
    path_efficiency: float | None
    accuracy_on_demonstrations: float | None
    accuracy_elsewhere: float | None
    failures: dict[str, float]
    """Share of all labyrinths, by outcome."""
    by_distance: dict[int, tuple[int, int]]
    """By moves on a shortest route: episodes that solved theirs, and all of them."""


def read_all(results_dir: Path) -> list[Evaluation]:
    """Return the evaluations that are kept, by config, setup, method and seed.

    Raises:
        DatasetError: There are none, or one cannot be read, or two of the same config are of
            different datasets, or two seeds of one method have different settings.
    """
    found = [read(path) for path in sorted((results_dir / "runs").glob("*/*.json"))]
    if not found:
        raise DatasetError(
            f"{results_dir} holds no evaluation, and neither does run_dir: "
            "stages=[train,evaluate] makes one"
        )
    first: dict[tuple[str, ...], Evaluation] = {}
    for each in found:
        other = first.setdefault((each.config,), each)
        if other.fingerprint != each.fingerprint:
            raise DatasetError(
                f"{each.path} and {other.path} are of different datasets, and not to be compared: "
                "remove one, or choose another results_dir"
            )
        other = first.setdefault((each.config, each.setup, each.method), each)
        differing = _differences(each, other)
        if differing:
            raise DatasetError(
                f"{each.path} and {other.path} are of different settings, {differing}, and not to "
                "be averaged: remove one, or choose another results_dir"
            )
    return sorted(found, key=_order)


def _differences(one: Evaluation, other: Evaluation) -> str:
    """Return in words in which settings two evaluations differ; empty if in none.

    Those that only one has are left out: they came later, and do nothing by default.
    """
    left, right = one.settings, other.settings
    common = [name for name in left if name in right]
    return ", ".join(
        f"{name}={left[name]} and {right[name]}" for name in common if left[name] != right[name]
    )


def _order(each: Evaluation) -> tuple[Any, ...]:
    known = list(METHODS)
    place = known.index(each.method) if each.method in known else len(known)
    return each.config, each.setup, place, each.method, each.seed


def read(path: Path) -> Evaluation:
    """Return the evaluation in a file.

    Raises:
        DatasetError: It is none.
    """
    try:
        content = json.loads(path.read_bytes())
        if content["format"] != FORMAT:
            raise ValueError(f"its format is {content['format']}, not {FORMAT}")
        about = content["run"]
        setup = [about["encoder"]]
        setup += [f"stride{about['pool_stride']}"] * (about["pool_stride"] != 1)
        setup += [about["protocol"]] * (about["protocol"] != "default")
        evaluation = Evaluation(
            path=path,
            config=str(about["config"]),
            method=str(about["method"]),
            setup="-".join(setup),
            seed=int(about["seed"]),
            fingerprint=str(about["fingerprint"]),
            settings=dict(about["settings"]),
            content=content,
        )
        for split in EVALUATED_SPLITS:
            episodes_of(content["splits"][split], cells_of(evaluation.config))
    except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
        raise DatasetError(f"{path} cannot be read: {error!r:.300}") from error
    return evaluation


def cells_of(config: str) -> int:
    """Return the cells of a labyrinth of a config such as `5x5` or `4x6-icy_floor`."""
    height, width = parse_size(config.partition("-")[0])
    return height * width


def summarise(evaluations: Sequence[Evaluation]) -> list[Figures]:
    """Return the figures of each method, setup and split, in the order of the evaluations."""
    groups: dict[tuple[str, str, str], list[Evaluation]] = {}
    for each in evaluations:
        groups.setdefault((each.config, each.setup, each.method), []).append(each)
    return [_over_seeds(group, split) for group in groups.values() for split in EVALUATED_SPLITS]


def _over_seeds(group: Sequence[Evaluation], split: str) -> Figures:
    first = group[0]
    told = [each.content["splits"][split] for each in group]
    episodes = [episodes_of(figures, cells_of(first.config)) for figures in told]
    solved = _solved(group, split)
    returns = np.stack([each.returns for each in episodes])
    outcomes = np.stack([each.outcomes for each in episodes])
    return Figures(
        config=first.config,
        setup=first.setup,
        method=first.method,
        split=split,
        seeds=len(group),
        sr=float(solved.mean()),
        sr_interval=interval(solved),
        aer=float(returns.mean()),
        aer_std=float(returns.std(axis=1).mean()),
        aer_interval=interval(returns),
        path_efficiency=_mean(each["path_efficiency"] for each in told),
        accuracy_on_demonstrations=_mean(each["accuracy_on_demonstrations"] for each in told),
        accuracy_elsewhere=_mean(each["accuracy_elsewhere"] for each in told),
        failures={name: float((outcomes == name).mean()) for name in list(OUTCOMES)[1:]},
        by_distance={
            int(moves): (sum(each["by_distance"][moves][0] for each in told), len(group) * count)
            for moves, (_, count) in told[0]["by_distance"].items()
        },
    )


def gap(group: Sequence[Evaluation]) -> tuple[float, float, float]:
    """Return the SR on train less that on test, of one method's seeds, and its interval."""
    train, test = (_solved(group, split) for split in ("train", "test"))
    return float(train.mean() - test.mean()), *interval(train, test)


def _solved(group: Sequence[Evaluation], split: str) -> NDArray[np.float64]:
    """Return 1 for each labyrinth that was solved, else 0, shape (seeds, labyrinths)."""
    cells = cells_of(group[0].config)
    told = [each.content["splits"][split] for each in group]
    return np.stack([episodes_of(figures, cells).solved for figures in told]).astype(np.float64)


def _mean(values: Iterable[float | None]) -> float | None:
    there = [value for value in values if value is not None]
    return sum(there) / len(there) if there else None
