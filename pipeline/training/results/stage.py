"""The stage `results`: tables of the evaluations of all runs, beside the paper's figures.

The evaluations are copied from `run_dir` to `<results_dir>/runs`, where they are kept; the tables
are made from these copies alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from rich.table import Column, Table

from labyrinth_core.data.storage import write_text
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS
from pipeline.config.run import Run
from pipeline.machinery.console import console
from pipeline.machinery.evaluation_file import EVALUATION
from pipeline.machinery.markdown import count
from pipeline.training.results.evaluations import (
    BY_METHOD,
    Figures,
    read,
    read_all,
    summarise,
)
from pipeline.training.results.paper import METHODS
from pipeline.training.results.result_tables import write_tables


def run(run: Run) -> None:
    """Collect the evaluations, and write the tables.

    Raises:
        DatasetError: There are none, one cannot be read, or two cannot be compared.
    """
    results_dir = Path(run.options.results_dir).expanduser()
    gather(Path(run.options.run_dir).expanduser(), results_dir)
    evaluations = read_all(results_dir)
    figures = summarise(evaluations)
    write_tables(results_dir, evaluations, figures)
    console.print(overview(figures))
    told = f"{count(len(evaluations), 'run')}: {results_dir}"
    console.print(told, highlight=False, soft_wrap=True)


def gather(run_dir: Path, results_dir: Path) -> None:
    """Copy the evaluations of finished runs to where they are kept.

    Raises:
        DatasetError: One cannot be read; what was kept of it before stays.
    """
    for path in sorted(run_dir.glob(f"*/*/{EVALUATION}")):
        read(path)
        target = results_dir / "runs" / path.parts[-3] / f"{path.parts[-2]}.json"
        target.parent.mkdir(parents=True, exist_ok=True)
        write_text(target, path.read_text(encoding="utf-8"))


def overview(figures: Sequence[Figures]) -> Table:
    """Return the success rates as a table for the terminal."""
    numbers = (Column(heading, justify="right") for heading in ("seeds", *EVALUATED_SPLITS))
    table = Table("dataset", "setup", "method", *numbers, title="SR in percent, mean over seeds")
    for _, grouped in groupby(figures, BY_METHOD):
        group = list(grouped)
        name = METHODS.get(group[0].method, group[0].method)
        rates = (f"{100 * each.sr:.1f}" for each in group if each.split in EVALUATED_SPLITS)
        table.add_row(group[0].config, group[0].setup, name, str(group[0].seeds), *rates)
    return table
