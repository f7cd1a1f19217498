"""The leaderboard as Markdown and as CSV."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from urllib.parse import quote

from labyrinth_core.data.splits import SPLITS
from labyrinth_core.data.storage import write_text
from labyrinth_core.evaluation.description import DETAILS
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS
from pipeline.machinery.markdown import plain, table
from pipeline.studies.results.leaderboard import RANKED_BY, Entry, Standing
from pipeline.studies.results.result_tables import aer_cell, sr_cell
from pipeline.studies.results.spreadsheet import as_csv

LEADERBOARD = "leaderboard.md"

MARK = "†"
"""Marks an entry whose labyrinths were not compared with those of the dataset."""

ABOUT = f"""# Leaderboard

Methods are ranked by SR on `{RANKED_BY}`, structures that nobody learns on. A rank is one more than
the number of methods whose interval lies wholly above: methods with one rank tie, and where two
intervals overlap, neither method is claimed to be better. The interval of 100% or 0% has no width,
which is too narrow. SR: share of the episodes that reach the goal, in percent. AER: average
episodic return, ± its standard deviation. Path efficiency: moves on a shortest route divided by
moves taken, in percent, over solved episodes. In brackets, 95% bootstrap intervals over labyrinths,
and over seeds or episodes where there are several. Within the step limit, a walk at random solves
most labyrinths.

All figures are computed from the outcome and the moves of each episode. What a method has learnt
from is as its authors state it; an empty cell is not stated. {MARK}: the dataset was not at hand
when this was made, so labyrinths and shortest routes are those that the file tells.

`leaderboard.csv` has all of this as numbers. `labyrinth-datasets stages=results` makes both files
of `runs/` and `submissions/`.
"""

COLUMNS = (
    *("config", "fingerprint", "rank", "method", "author", "url", "date", "budget"),
    *("train_labyrinths", "train_steps", "parameters"),
    *("observation", "seeds", "episodes", "version", "compared"),
    *("split", "labyrinths", "sr", "sr_low", "sr_high"),
    *("aer", "aer_std", "aer_low", "aer_high", "path_efficiency"),
)
"""The columns of `leaderboard.csv`."""


def write_leaderboard(folder: Path, boards: Sequence[Sequence[Entry]]) -> None:
    """Write `leaderboard.md` and `leaderboard.csv` into a folder."""
    parts = [ABOUT]
    for entries in boards:
        parts += [part + "\n" for part in markdown(entries)]
    write_text(folder / LEADERBOARD, "\n".join(parts))
    write_text(folder / "leaderboard.csv", csv_of([e for entries in boards for e in entries]))


def markdown(entries: Sequence[Entry]) -> Iterator[str]:
    """Yield the heading and the tables of one dataset."""
    yield f"## {entries[0].config}"
    yield f"The dataset's fingerprint is `{entries[0].fingerprint}`."
    heading = ["rank", "method", "by", *(f"{name} on {RANKED_BY}" for name in ("SR", "AER"))]
    heading += ["path efficiency", "labyrinths"]
    yield table(heading, map(_place, entries), "rllrrrr")
    yield "On all splits:"
    held = {split for each in entries for split in each.standings}
    # The usual ones first, then the others in the order of the dataset.
    splits = [split for split in dict.fromkeys((*EVALUATED_SPLITS, *SPLITS)) if split in held]
    rows = (row for each in entries for row in _by_split(each, splits))
    yield table(["method", "", *splits], rows, "ll" + "r" * len(splits))
    yield "What they have learnt from, and how they were evaluated:"
    heading = ["method", "budget", *DETAILS, "seeds", "sees", "episodes", "version", "date"]
    yield table(heading, map(_effort, entries), "ll" + "r" * len(DETAILS) + "rlrll")


def _place(entry: Entry) -> list[str]:
    mine = entry.standings.get(RANKED_BY)
    rank = "" if entry.rank is None else str(entry.rank)
    figures = ["", "", "", ""] if mine is None else [*_figures(mine), f"{mine.labyrinths:,}"]
    return [rank, _name(entry, linked=True), plain(entry.method.author), *figures]


def _by_split(entry: Entry, splits: Sequence[str]) -> Iterator[list[str]]:
    standings = [entry.standings.get(split) for split in splits]
    cells = [("", "", "") if each is None else _figures(each) for each in standings]
    for name, *row in zip(("SR", "AER", "path efficiency"), *cells, strict=True):
        yield [_name(entry), name, *row]


def _figures(standing: Standing) -> tuple[str, str, str]:
    efficiency = standing.path_efficiency
    percent = "" if efficiency is None else f"{100 * efficiency:.1f}"
    return sr_cell(standing), aer_cell(standing), percent


def _effort(entry: Entry) -> list[str]:
    method = entry.method
    details = (f"{method.details[name]:,}" if name in method.details else "" for name in DETAILS)
    evaluated = [str(entry.seeds), plain(entry.observation), str(entry.episodes)]
    return [
        *(_name(entry), plain(method.budget), *details),
        *(*evaluated, plain(entry.version), method.date),
    ]


def _name(entry: Entry, *, linked: bool = False) -> str:
    name, url = plain(entry.method.name), entry.method.url
    if linked and url:
        name = f"[{name}]({quote(url, safe=':/?#@!&*+,;=%~')})"
    return name if entry.compared else f"{name} {MARK}"


def csv_of(entries: Sequence[Entry]) -> str:
    """Return all figures, a row for each method and split; shares, not percent."""
    rows = (_row(entry, split) for entry in entries for split in entry.standings)
    return as_csv(COLUMNS, rows)


def _row(entry: Entry, split: str) -> dict[str, object]:
    method, standing = entry.method, entry.standings[split]
    row = asdict(entry) | asdict(method) | asdict(standing)
    row |= {"method": method.name, "split": split, "parameters": method.details.get("parameters")}
    row |= {f"train_{name}": method.details.get(name) for name in ("labyrinths", "steps")}
    for name in ("sr", "aer"):
        row[f"{name}_low"], row[f"{name}_high"] = row[f"{name}_interval"]
    return row
