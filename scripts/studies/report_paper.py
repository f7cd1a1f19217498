"""Tables for results.md, from docs/results: our runs beside the paper, and the effect of memory.

`report_pages.py` writes them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from kept_results import RESULTS, Run, by_method, read_runs, solved_in, whole

from labyrinth_core.data import SPLITS
from labyrinth_core.evaluation.replanner import REPLANNERS
from pipeline.machinery import table
from pipeline.results.leaderboard import name_of
from pipeline.results.tables import paper_figures

REFERENCES = {
    "route memory": ("route_memory", "sr"),
    "look-up on local walls": ("local_walls", "sr"),
    "uniformly random": ("random", "sr"),
    "the same, in n x n steps": ("random", "sr_within_cells"),
}
"""Name of a baseline in print -> its name in a file, and its figure."""

Cell = Callable[[str], str]
"""Split -> the cell of the table."""


def splits() -> list[str]:
    """Return the names of the paper's splits in print."""
    return [f"`{split}`" if split.startswith("s0") else split for split in SPLITS.evaluated]


def of_size(config: str) -> str:
    """Return a table of all runs of a size, with the paper's figures in parentheses."""
    folder = f"runs/{config}"
    rows = []
    for pattern, note in (
        ("*-cnn-seed?.json", ""),
        ("bc-cnn-seed?-paper.json", ", `protocol=paper`"),
        ("planner-seed?.json", ""),
    ):
        if not any((RESULTS / folder).glob(pattern)):
            continue
        for name, runs in by_method(read_runs(folder, pattern)).items():
            cells = map(partial(_beside, config, runs), SPLITS.evaluated)
            rows.append([name + note, str(len(runs)), *cells])
    baselines = read_runs(folder, "bc-cnn-seed0.json")[0]["baselines"]
    for name, (kept, figure) in REFERENCES.items():
        cells = (whole(baselines[kept][split][figure]) for split in SPLITS.evaluated)
        rows.append([f"*{name}*", "", *cells])
    return table([config, "seeds", *splits()], rows)


def _beside(config: str, runs: Sequence[Run], split: str) -> str:
    ours = whole(solved_in(runs, split).mean())
    printed = paper_figures().get((config, split, runs[0]["run"]["method"]))
    return f"{ours} ({whole(printed.sr)})" if printed else ours


def memory() -> str:
    """Return a table of SR and SPL under partial observability, with and without memory."""
    runs = read_runs("memory/runs/5x5-partial_observability")
    rows = []
    for method in ("planner", "bc"):
        for remembers, note in ((True, " with memory"), (False, "")):
            group = [
                each
                for each in runs
                if (each["run"]["method"], each["run"].get("memory", False)) == (method, remembers)
            ]
            cells = (
                _with_spl([each["splits"][split] for each in group]) for split in SPLITS.evaluated
            )
            rows.append([name_of(method) + note, str(len(group)), *cells])
    for name, title in zip(
        REPLANNERS, ("optimistic replanner, memory", "the same without memory"), strict=True
    ):
        told = runs[0]["baselines"][name]
        rows.append([f"*{title}*", "", *(_with_spl([told[split]]) for split in SPLITS.evaluated)])
    return table(["SR / SPL in percent", "seeds", *splits()], rows)


def _with_spl(told: Sequence[dict[str, Any]]) -> str:
    """Return SR and SPL in percent, averaged over files."""
    return " / ".join(
        whole(float(np.mean([each[name] for each in told]))) for name in ("sr", "spl")
    )
