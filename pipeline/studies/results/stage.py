"""The stage `results`: tables of all evaluations beside the paper's figures, and the leaderboard.

The evaluations of runs are copied from `run_dir` to `<results_dir>/runs`, and the results of other
policies to `<results_dir>/submissions`, where anybody's may lie; tables and leaderboard are made
from what is kept there alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from rich.table import Column, Table

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.storage import write_text
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS
from pipeline.config.run import Run
from pipeline.machinery.console import console, say
from pipeline.machinery.evaluation_file import EVALUATION
from pipeline.machinery.markdown import count
from pipeline.studies.results import submissions
from pipeline.studies.results.evaluations import (
    BY_METHOD,
    Figures,
    read,
    read_all,
    summarise,
)
from pipeline.studies.results.known import AtHand
from pipeline.studies.results.leaderboard import boards, entries_of
from pipeline.studies.results.leaderboard_tables import LEADERBOARD, write_leaderboard
from pipeline.studies.results.paper import METHODS
from pipeline.studies.results.result_tables import write_tables


class RefusedError(DatasetError):
    """Results that do not add up; the message has one line for each file."""


def run(run: Run) -> None:
    """Collect the evaluations and anybody's results, and write the tables and the leaderboard.

    Files of others that do not add up are left out of the leaderboard, and told at the end.

    Raises:
        ConfigError: A folder is given with a revision.
        DatasetError: There is nothing, an evaluation cannot be read, or two cannot be compared.
        RefusedError: Results of others do not add up; all else is written.
    """
    run_dir, results_dir = (
        Path(folder).expanduser() for folder in (run.options.run_dir, run.options.results_dir)
    )
    gather(run_dir, results_dir)
    at_hand = AtHand(run)
    refused = submissions.gather(run_dir, results_dir, at_hand)
    others, also_refused = submissions.read_all(results_dir, at_hand)
    refused += also_refused
    evaluations = read_all(results_dir)
    if not (evaluations or others or refused):
        raise DatasetError(
            f"{results_dir} holds no evaluation, and neither does run_dir: "
            "stages=[train,evaluate] makes one"
        )
    figures = summarise(evaluations)
    if evaluations:
        write_tables(results_dir, evaluations, figures)
        console.print(overview(figures))
        say(f"{count(len(evaluations), 'run')}: {results_dir}")
    entries = list(entries_of(evaluations, figures, others))
    write_leaderboard(results_dir, boards(entries))
    for config, reason in at_hand.missing.items():
        say(f"{config} is not at hand, so results on it are compared with no dataset: {reason}")
    say(f"{count(len(entries), 'method')}: {results_dir / LEADERBOARD}")
    if refused:
        left_out = f"{count(len(refused), 'file')} not on the leaderboard:"
        raise RefusedError("\n  ".join([left_out, *refused]))


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
