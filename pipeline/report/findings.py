"""The evaluated runs that the report shows, read from the files that `evaluate` has left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import mean
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import MALFORMED, DatasetError, one_line
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.splits import is_of_train
from labyrinth_core.evaluation.following import OUTCOMES
from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS
from pipeline.machinery.evaluation_file import EVALUATION, check_evaluation
from pipeline.machinery.schema import read_json

MOST_FAILED = 2_000
"""The most labyrinths of a split that are named because a run failed on them."""
_SOLVED = next(iter(OUTCOMES))[0]
"""The letter of an episode that reached the goal, the first letter of its outcome."""

SCORES = (
    "labyrinths",
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


def read_results(run_dir: Path, manifests: Sequence[Manifest]) -> list[dict[str, Any]]:
    """Return the data of the page on the methods evaluated on datasets, each with its runs.

    A method is all that a run's name says but its seed, such as `bc-resnet18`.

    Args:
        run_dir: The folder of the runs; it need not exist.
        manifests: The manifests of the datasets; runs on others are left out.

    Raises:
        DatasetError: A file cannot be read.
    """
    of = {manifest.config.name: manifest for manifest in manifests}
    methods: dict[tuple[str, str], list[_Run]] = {}
    for path in sorted(run_dir.glob(f"*/*/{EVALUATION}")):
        try:
            run = _run(path.parent.name, of, read_json(path))
        except (OSError, *MALFORMED) as error:
            raise DatasetError(f"{path} cannot be read: {one_line(error):.300}") from error
        if run is not None:
            methods.setdefault((run.config, run.method), []).append(run)
    return [_method(sorted(runs, key=lambda run: run.seed)) for runs in methods.values()]


class _Run(NamedTuple):
    """One run's evaluation."""

    config: str
    """The config of the dataset, such as `5x5`."""
    method: str
    seed: int
    told: Mapping[str, Any]
    """The data of the page on this run alone."""
    solved: Mapping[str, NDArray[np.float64]]
    """Split -> 1 for each labyrinth that was solved, else 0, shape (labyrinths,)."""
    failed: Mapping[str, Sequence[str]]
    """Split -> ids of the labyrinths that were not solved."""
    baselines: Mapping[str, Any]


def _run(name: str, of: Mapping[str, Manifest], content: Mapping[str, Any]) -> _Run | None:
    """Return the run of an evaluation, None if its dataset is not there."""
    run = content["run"]
    manifest = of.get(run["config"])
    if manifest is None or manifest.fingerprint != run["fingerprint"]:
        return None
    check_evaluation(content)
    seed, told, solved, failed = run["seed"], {}, {}, {}
    for split in EVALUATED_SPLITS:
        scores = content["splits"][split]
        solved[split] = np.array([letter == _SOLVED for letter in scores["outcomes"]], np.float64)
        failed[split] = scores["failed"]
        held = sum(shard.labyrinths for shard in manifest.of(split))
        if is_of_train(split) and run.get("train_labyrinths") is not None:
            held = int(run["train_labyrinths"])
        if len(solved[split]) != held:
            raise ValueError(f"{split} has {held} labyrinths, not {len(solved[split])}")
        told[split] = {figure: scores[figure] for figure in SCORES} | _named(failed[split])
    method = name.replace(f"-seed{seed}", "", 1)
    shown = {"name": name, "splits": told}
    return _Run(run["config"], method, seed, shown, solved, failed, content["baselines"])


def _method(runs: Sequence[_Run]) -> dict[str, Any]:
    """Return the data of the page on a method: means over its runs, and each run."""
    splits = {}
    for split in EVALUATED_SPLITS:
        told = [run.told["splits"][split] for run in runs]
        solved = np.stack([run.solved[split] for run in runs])
        by_all = set.intersection(*(set(run.failed[split]) for run in runs))
        splits[split] = {
            "sr": float(solved.mean()),
            "sr_interval": interval(solved),
            "aer": mean(each["aer"] for each in told),
            "aer_std": mean(each["aer_std"] for each in told),
            **_named([number for number in runs[0].failed[split] if number in by_all]),
        }
    return {
        "config": runs[0].config,
        "name": runs[0].method,
        "splits": splits,
        "baselines": runs[0].baselines,
        "runs": [run.told for run in runs],
    }


def _named(failed: Sequence[str]) -> dict[str, Any]:
    """Return the ids of labyrinths that were not solved, up to a limit, and how many there are."""
    return {"failed": failed[:MOST_FAILED], "unsolved": len(failed)}
