"""The stage `results`: write tables that compare all runs with the paper, and the leaderboard.

Results of runs are copied from `run_dir` to `<results_dir>/runs`, and those of other policies to
`<results_dir>/submissions`, to which anyone may add files. Tables and leaderboard are made only
from these two folders.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from rich.table import Column, Table

from labyrinth_core.data import SPLITS
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Results
from pipeline.config import Job
from pipeline.machinery import Sums, count, leave, say
from pipeline.results.checking import RUNS, Checks, comparable, gather, of_equal_weights, read_all
from pipeline.results.leaderboard import (
    LEADERBOARD,
    Entry,
    boards,
    entries_of,
    leaderboard,
    title_of,
)
from pipeline.results.options import ResultsOptions
from pipeline.results.tables import tables


class RefusedError(DatasetError):
    """Some results are inconsistent; the message has one line for each file."""


def run(job: Job[ResultsOptions]) -> None:
    """Collect the results of runs and of other policies; write the tables and the leaderboard.

    Inconsistent files are left out, and named at the end.

    Raises:
        ConfigError: A folder is given with a revision.
        DatasetError: There are no results, or none on the dataset that the command line names, or
            two runs cannot be compared.
        RefusedError: Some files are inconsistent; everything else is written.
    """
    checks, overwrite = Checks(job), job.options.overwrite
    results_dir = Path(job.options.results_dir).expanduser()
    copies, refused = gather(checks, results_dir, overwrite)
    runs, submissions, also_refused = read_all(checks, results_dir, copies)
    refused += also_refused
    if not (runs or submissions or refused):
        raise DatasetError(
            f"{results_dir} holds no results, and neither does run_dir: "
            "'stages=[train,evaluate]' makes some"
        )
    configs = {each.config for each in [*runs.values(), *submissions]}
    if job.names_dataset and job.dataset.name not in configs and not refused:
        raise DatasetError(
            f"there are no results on {job.dataset.name}: those of {checks.run_dir} and "
            f"{results_dir} are on {', '.join(sorted(configs))}; leave size and task out to "
            "compare them"
        )
    if copies:
        files = {name: path.read_bytes() for name, (path, _) in copies.items()}
        leave(results_dir, files, overwrite=overwrite)
    kept = [*comparable(runs), *submissions]
    entries = entries_of(kept, checks.is_compared, checks.is_replayed)
    methods = [each for each in entries if each.results[0].run is not None]
    texts = leaderboard(boards(entries))
    if methods or Sums.read(results_dir).has("results.csv"):
        texts = tables(methods) | texts
    leave(results_dir, {name: each.encode() for name, each in texts.items()}, overwrite=overwrite)
    if methods:
        for _, of_config in groupby(methods, lambda each: each.config):
            say(overview(list(of_config)))
        say(Results.LEGEND[0], once=True)
        say(f"{count(len(runs), 'run')}: {results_dir}")
    for paths in of_equal_weights(runs):
        names = ", ".join(str(path.relative_to(results_dir / RUNS)) for path in paths)
        say(f"Equal weights, so one policy that counts {len(paths)} times: {names}")
    for config, reason in checks.missing.items():
        say(f"{config} is not available, so results on it have no rank: {reason}")
    for reason, skipped in checks.skipped.items():
        say(f"{count(skipped, 'file')} not replayed: {reason}")
    say(f"{count(len(entries), 'method')}: {results_dir / LEADERBOARD}")
    if refused:
        left_out = f"{count(len(refused), 'file')} not on the leaderboard:"
        raise RefusedError("\n  ".join([left_out, *refused]))


def overview(methods: Sequence[Entry]) -> Table:
    """Return a table of the SPL of all methods on one dataset.

    In a terminal of 80 columns, long method names wrap.
    """
    title = f"{methods[0].config}: SPL in percent, mean over seeds"
    numbers = ("seeds", *SPLITS.evaluated)
    columns = (Column(heading, justify="right", no_wrap=True) for heading in numbers)
    table = Table(Column("method", overflow="fold"), *columns, title=title)
    for each in methods:
        rates = (f"{100 * each.figures[split]['spl']:.1f}" for split in SPLITS.evaluated)
        table.add_row(title_of(each.run), str(len(each.results)), *rates)
    return table
