"""The evaluated runs that the report shows, read from the files that `evaluate` has left."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import mean
from typing import Any

import numpy as np

from labyrinth_core.data.manifest import Manifest
from labyrinth_core.evaluation.description import TrainedRun
from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.evaluation.known import KnownDataset
from labyrinth_core.evaluation.results import Results, results_in
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS, Scores

MOST_FAILED = 2_000
"""The most labyrinths of a split that are named because a run failed on them."""

SCORES = (
    "labyrinths",
    "spl",
    "sr_within_cells",
    "sr",
    "sr_interval",
    "aer",
    "aer_std",
    "path_efficiency",
    "accuracy_on_demonstrations",
    "accuracy_elsewhere",
    "failures",
)
"""The scores of a run on a split that are shown."""


def read_results(
    run_dir: Path, data_dir: Path, manifests: Sequence[Manifest]
) -> list[dict[str, Any]]:
    """Return the data of the page on the methods evaluated on datasets, each with its runs.

    A method is all that the name of a run says but its seed, such as `bc-resnet18`.

    Args:
        run_dir: The folder of the runs; it need not exist.
        data_dir: The folder of the datasets.
        manifests: The manifests of the datasets; runs on others are left out, and so are results
            of policies that no run made.

    Raises:
        DatasetError: A file is refused.
    """
    of = {
        manifest.config.name: KnownDataset(str(data_dir), manifest.config.name, None, manifest)
        for manifest in manifests
    }
    methods: dict[tuple[str, str], list[tuple[TrainedRun, Results]]] = {}
    for path in results_in(run_dir):
        results = Results.load(path, of.get)
        run, known = results.run, of.get(results.config)
        if run is None or known is None or known.fingerprint != results.fingerprint:
            continue
        methods.setdefault((results.config, run.of_all_seeds), []).append((run, results))
    return [
        _method(name, sorted(runs, key=lambda each: each[0].seed))
        for (_, name), runs in methods.items()
    ]


def _method(name: str, runs: Sequence[tuple[TrainedRun, Results]]) -> dict[str, Any]:
    """Return the data of the page on a method: means over its runs, and each run."""
    first = runs[0][1]
    told = [
        {"name": run.name, "splits": {split: _run(found[split]) for split in EVALUATED_SPLITS}}
        for run, results in runs
        for found in [results.splits]
    ]
    splits = {}
    for split in EVALUATED_SPLITS:
        scores = [results.splits[split] for _, results in runs]
        solved = np.concatenate([np.atleast_2d(each.episodes.solved) for each in scores])
        weighted = np.concatenate([np.atleast_2d(each.weighted) for each in scores])
        by_all = set.intersection(*(set(each.failed) for each in scores))
        splits[split] = {
            "spl": mean(each.spl for each in scores),
            "spl_interval": interval(weighted),
            "sr_within_cells": mean(each.sr_within_cells for each in scores),
            "sr": float(solved.mean()),
            "sr_interval": interval(solved.astype(np.float64)),
            "aer": mean(each.aer for each in scores),
            "aer_std": mean(float(each.episodes.returns.std()) for each in scores),
            **_named([number for number in scores[0].failed if number in by_all]),
        }
    return {
        "config": first.config,
        "name": name,
        "splits": splits,
        "baselines": {
            split: {each: found[split] for each, found in first.baselines.items()}
            for split in EVALUATED_SPLITS
        },
        "runs": told,
    }


def _run(scores: Scores) -> dict[str, Any]:
    figures = scores.figures()
    return {figure: figures[figure] for figure in SCORES} | _named(scores.failed)


def _named(failed: Sequence[str]) -> dict[str, Any]:
    """Return the ids of labyrinths that were not solved, up to a limit, and how many there are."""
    return {"failed": failed[:MOST_FAILED], "unsolved": len(failed)}
