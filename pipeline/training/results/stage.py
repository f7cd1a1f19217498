"""The stage `results`: the evaluations of all runs, in tables beside the paper's figures.

Evaluations are gathered from `run_dir` into `<results_dir>/runs`, where they are kept: they are
small, and the tables are made of them alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from labyrinth_core.data.storage import write_text
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS
from pipeline.config.run import Run
from pipeline.machinery.console import console
from pipeline.machinery.markdown import count
from pipeline.training.results.evaluations import EVALUATION, Figures, read_all, summarise
from pipeline.training.results.paper import METHODS
from pipeline.training.results.result_tables import write_tables


def run(run: Run) -> None:
    """Gather the evaluations, and write tables of them.

    Raises:
        DatasetError: There are none, or one cannot be read, or two are of other datasets.
    """
    results_dir = Path(run.options.results_dir).expanduser()
    gather(Path(run.options.run_dir).expanduser(), results_dir)
    evaluations = read_all(results_dir)
    figures = summarise(evaluations)
    write_tables(results_dir, evaluations, figures)
    console.print(overview(figures))
    console.print(
        f"{count(len(evaluations), 'run')}: {results_dir}",
        highlight=False,
        soft_wrap=True,
    )


def gather(run_dir: Path, results_dir: Path) -> None:
    """Copy the evaluations of finished runs to where they are kept."""
    for path in sorted(run_dir.glob(f"*/*/{EVALUATION}")):
        target = results_dir / "runs" / path.parts[-3] / f"{path.parts[-2]}.json"
        target.parent.mkdir(parents=True, exist_ok=True)
        write_text(target, path.read_text(encoding="utf-8"))


def overview(figures: Sequence[Figures]) -> Table:
    """Return the table for the terminal: success rates, in percent."""
    table = Table(title="SR in percent, mean over seeds")
    for heading in ("dataset", "setup", "method"):
        table.add_column(heading)
    for heading in ("seeds", *EVALUATED_SPLITS):
        table.add_column(heading, justify="right")
    rows: dict[tuple[str, str, str, str], list[str]] = {}
    for each in figures:
        key = (each.config, each.setup, METHODS.get(each.method, each.method), str(each.seeds))
        rows.setdefault(key, []).append(f"{100 * each.sr:.1f}")
    for key, rates in rows.items():
        table.add_row(*key, *rates)
    return table
