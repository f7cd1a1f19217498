"""What others found out about a dataset, as files beside it: its analysis, and evaluated runs.

The report reads their files, not their code, and tells the page what it shows of them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pipeline.manifest import ANALYSIS, DatasetError, Manifest

EVALUATIONS = "*/*/evaluation.json"
"""In the folder of runs, by the stage `evaluate`."""

EXAMPLES = 20
"""Labyrinths named that two splits have in common, of each kind."""
MOST_FAILED = 2_000
"""Labyrinths named on which a run failed, in each split."""

KINDS = ("equal", "mirrored", "symmetric", "same_route")
"""What two labyrinths may have in common."""
FIGURES = (
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
"""What is shown of a run on a split."""

Told = TypeVar("Told")


def read_analysis(folder: Path, manifest: Manifest) -> dict[str, Any] | None:
    """Return what the page shows of the analysis of a dataset, None if it was not analysed.

    An analysis of what was in the folder before is none.

    Raises:
        DatasetError: The file cannot be read.
    """
    path = folder / ANALYSIS
    return _read(path, partial(_analysis, manifest)) if path.is_file() else None


def _analysis(manifest: Manifest, content: Mapping[str, Any]) -> dict[str, Any] | None:
    if content["fingerprint"] != manifest.fingerprint:
        return None
    leakage = content["leakage"]
    return {
        "labyrinths": leakage["labyrinths"],
        "repeated": leakage["repeated"],
        "strangers": {split: len(ids) for split, ids in leakage["strangers"].items()},
        "pairs": [_pair(pair) for pair in leakage["pairs"]],
        "permutations": content["shift"]["permutations"],
        "shift": content["shift"]["measures"],
    }


def _pair(pair: Mapping[str, Any]) -> dict[str, Any]:
    walls = sorted(apart for _, apart in pair["nearest"].values())
    return {
        "first": pair["first"],
        "second": pair["second"],
        "counts": {kind: len(pair[kind]) for kind in KINDS},
        "examples": {kind: list(pair[kind].items())[:EXAMPLES] for kind in KINDS},
        "within": pair["within"],
        "walls": [walls[0], walls[len(walls) // 2]] if walls else None,
    }


def read_runs(run_dir: Path, manifests: Sequence[Manifest]) -> list[dict[str, Any]]:
    """Return what the page shows of the evaluated runs of datasets.

    Args:
        run_dir: Folder of the runs; there need not be one.
        manifests: Of the datasets; runs of others are left out.

    Raises:
        DatasetError: A file cannot be read.
    """
    fingerprints = {manifest.config.name: manifest.fingerprint for manifest in manifests}
    runs = [
        _read(path, partial(_run, path.parent.name, fingerprints))
        for path in sorted(run_dir.glob(EVALUATIONS))
    ]
    return [run for run in runs if run is not None]


def _run(
    name: str, fingerprints: Mapping[str, str], content: Mapping[str, Any]
) -> dict[str, Any] | None:
    run = content["run"]
    if fingerprints.get(run["config"]) != run["fingerprint"]:
        return None
    return {
        "name": name,
        "config": run["config"],
        "baselines": content["baselines"],
        "splits": {
            split: {figure: scores[figure] for figure in FIGURES}
            | {"failed": scores["failed"][:MOST_FAILED], "unsolved": len(scores["failed"])}
            for split, scores in content["splits"].items()
        },
    }


def _read(path: Path, tell: Callable[[Any], Told]) -> Told:
    try:
        return tell(json.loads(path.read_bytes()))
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise DatasetError(f"{path} cannot be read: {error!r:.300}") from error
