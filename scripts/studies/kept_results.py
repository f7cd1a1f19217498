"""Read the result files of all studies in docs/results, and format them as cells of tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.scores import interval
from labyrinth_core.storage import File
from pipeline.results.leaderboard import IN_PRINT, name_of

RESULTS = Path(__file__).parents[2] / "docs/results"

Run = dict[str, Any]
"""The file of a run; `solved` maps each set or split to 1 or 0 per labyrinth, shape (L,)."""
Groups = Mapping[str, Sequence[Run]]
"""The runs of each method, one for each seed."""


def read_run(path: Path) -> Run:
    """Read a file of an archived study (docs/results/ARCHIVE.md), or of the stage `evaluate`.

    The figures of `evaluate` are not checked here: `Results.load` does so in a test of all files.
    """
    kept: Run = File(path).read_json()
    marks = kept.get("solved") or {
        split: each["outcomes"][0] for split, each in kept.get("splits", {}).items()
    }
    kept["solved"] = {
        name: np.array([mark in "1s" for mark in digits], np.float64)
        for name, digits in marks.items()
    }
    return kept


def read_runs(folder: str, pattern: str = "*.json") -> list[Run]:
    """Read the files in a folder of docs/results, sorted by name.

    Raises:
        ValueError: No file matches.
    """
    paths = sorted((RESULTS / folder).glob(pattern))
    if not paths:
        raise ValueError(f"{folder} holds no {pattern}")
    return [read_run(path) for path in paths]


def by_method(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """Group runs by the name of their method: the paper's first, in its order."""
    found = {each["run"]["method"] for each in runs}
    order = [*(name for name in IN_PRINT if name in found), *sorted(found - IN_PRINT.keys())]
    return {
        name_of(method): [each for each in runs if each["run"]["method"] == method]
        for method in order
    }


def solved_in(group: Sequence[Run], name: str) -> NDArray[np.float64]:
    """Return 1 for each solved labyrinth of a set, else 0, shape (seeds, labyrinths)."""
    return np.stack([each["solved"][name] for each in group])


def percent(mean: float, low: float, high: float) -> str:
    """Return a share and its interval, in percent."""
    return f"{round(100 * mean)} [{round(100 * low)}, {round(100 * high)}]"


def bounds(solved: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the share that was solved, and its 95% interval over seeds and labyrinths."""
    return float(solved.mean()), *interval(solved)


def rate(solved: NDArray[np.float64]) -> str:
    """Return the share that was solved and its interval, as text in percent."""
    return percent(*bounds(solved))


def whole(share: float) -> str:
    """Return a share in whole percent."""
    return f"{round(100 * share)}"
