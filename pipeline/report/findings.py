"""The results of policies that the report shows, from evaluated runs and from submissions."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import asdict
from pathlib import Path
from typing import Any

from labyrinth_core.data import SPLITS, Dataset
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import KnownDataset, Results
from pipeline.config import ResultFolderOptions
from pipeline.machinery import say

MOST_FAILED = 2_000
"""The maximum number of labyrinths listed per split on which a run failed."""

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
"""The scores shown for a run on a split."""


def read_results(
    run_dir: Path,
    datasets: Sequence[Dataset],
    results_dir: Path | None = None,
) -> list[dict[str, Any]]:
    """Return the page's data on the methods evaluated on the datasets, each with its runs.

    A method is the name of a run without its seed, such as `bc-resnet18`. Policies that no run
    trained come after those, each as a method with one run; they may lack splits.

    Args:
        run_dir: The folder of the runs; it need not exist.
        datasets: The datasets; results on others are left out.
        results_dir: The folder with submitted results, if any. An invalid file there is named on
            the terminal and left out.

    Raises:
        DatasetError: A results file in the folder of the runs is invalid.
    """
    of = {data.config: KnownDataset(data) for data in datasets}

    def is_shown(results: Results) -> bool:
        known = of.get(results.config)
        return known is not None and known.fingerprint == results.fingerprint

    seeds: dict[tuple[str, str, str], list[Results]] = {}
    others: list[Results] = []
    paths = Results.files_of_runs(run_dir)
    for path in paths:
        results = Results.load(path, of.get)
        run = results.run
        if run is not None and (results.config, run.name) != path.parts[-3:-1]:
            say(f"left out: {path} belongs to the run {results.config}/{run.name}, not to this one")
        elif run is not None and is_shown(results):
            settings = json.dumps(run.settings, sort_keys=True)
            seeds.setdefault((results.config, run.of_all_seeds, settings), []).append(results)
        elif is_shown(results):
            others.append(results)
    named = Counter((config, name) for config, name, _ in seeds)
    named.update((each.config, each.about.name) for each in others)
    found = []
    for (config, name, _), runs in seeds.items():
        # Seeds with other settings are another method, and are named as runs.
        title = name if named[config, name] == 1 else runs[0].about.name
        found.append(_method(title, sorted(runs, key=lambda each: each.seed)))
    found += [_method(each.about.name, [each]) for each in others]
    for results in _submitted(results_dir, {path.read_bytes() for path in paths}, of.get):
        if is_shown(results):
            about = {"submitted": True, "author": results.about.author}
            found.append(_method(results.about.name, [results]) | about)
    return found


def _submitted(
    results_dir: Path | None, others: Set[bytes], of: Callable[[str], KnownDataset | None]
) -> Iterator[Results]:
    """Yield the submitted results, without those that `stages=results` copied there."""
    if results_dir is None:
        return
    for path, reason in Results.submitted_files(results_dir / ResultFolderOptions.SUBMISSIONS):
        try:
            if reason:
                raise DatasetError(f"{path}: {reason}")
            if path.read_bytes() not in others:
                yield Results.load(path, of)
        except DatasetError as error:
            say(f"left out: {error}")


def _method(name: str, runs: Sequence[Results]) -> dict[str, Any]:
    """Return the page's data on a method: means over its runs, and each run."""
    first = runs[0]
    splits_of_all = set.intersection(*(set(run.splits) for run in runs))
    shown = [split for split in (*SPLITS.evaluated, *SPLITS.shifts) if split in splits_of_all]
    told = [
        {
            "name": run.about.name,
            "splits": {split: _run(run, split) for split in shown},
            "memorised": None if run.memorised is None else asdict(run.memorised),
        }
        for run in runs
    ]
    splits = {}
    for split in shown:
        scores, figures = [run.splits[split] for run in runs], Results.over_seeds(runs, split)
        by_all = set.intersection(*(set(each.failed) for each in scores))
        splits[split] = {
            **{name: figures[name] for name in ("spl", "sr_within_cells", "sr", "aer", "aer_std")},
            **{
                f"{name}_interval": (figures[f"{name}_low"], figures[f"{name}_high"])
                for name in ("spl", "sr")
            },
            **_named([number for number in scores[0].failed if number in by_all]),
        }
    return {
        "config": first.config,
        "name": name,
        "splits": splits,
        "baselines": {
            split: {each: found[split] for each, found in first.baselines.items()}
            for split in shown
        },
        "runs": told,
        "submitted": False,
    }


def _run(run: Results, split: str) -> dict[str, Any]:
    scores = run.splits[split]
    figures = scores.figures()
    return {figure: figures[figure] for figure in SCORES} | _named(scores.failed)


def _named(failed: Sequence[str]) -> dict[str, Any]:
    """Return the ids of unsolved labyrinths, at most `MOST_FAILED`, and how many there are."""
    return {"failed": failed[:MOST_FAILED], "unsolved": len(failed)}
