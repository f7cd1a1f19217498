"""`labyrinth convert` for arrays and folders: write their labyrinths as text."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

from labyrinth_core.command.arguments import RequestError
from labyrinth_core.language.collection import KINDS, Entry, read_collection
from labyrinth_core.language.source_text import printable_line
from labyrinth_core.language.text import dump
from labyrinth_core.world import Labyrinth, LabyrinthError, Structure

PROBLEMS_SHOWN = 10
"""The most problems to print."""


def convert(source: Path, output: Path | None) -> int:
    """Convert labyrinths, print each problem, and return the exit status: 1 if there was any.

    Args:
        source: The file or folder.
        output: The new folder, written completely or not at all; None to print the only labyrinth.

    Raises:
        RequestError: There is no labyrinth, or several but no `output`, or `output` is not new.
        OSError: A file cannot be read or written.
    """
    entries = _entries(source)
    if output is not None:
        return _write(source, entries, output)
    few = list(islice(entries, 2))
    if len(few) > 1:
        raise RequestError(f"{source} holds several labyrinths: give --output FOLDER")
    if not few:
        raise _nothing(source)
    ((_, text, problem),) = few
    sys.stdout.write(text)
    _explain([problem] if problem else [])
    return int(bool(problem))


def _entries(source: Path) -> Iterator[tuple[str, str, str]]:
    """Yield each labyrinth's split, text and problem; the text is empty if there is a problem."""
    for entry in read_collection(source):
        try:
            yield entry.split, _text(entry), entry.problem
        except LabyrinthError as error:  # No route joins the default start and goal.
            yield entry.split, "", f"{entry.place}: {error}"


def _text(entry: Entry) -> str:
    found = entry.found
    if found is None:
        return ""
    if isinstance(found, Structure):
        found = Labyrinth(found, *found.default_ends)
    return dump(found)


def _write(source: Path, entries: Iterator[tuple[str, str, str]], output: Path) -> int:
    if output.exists() or not output.parent.is_dir():
        reason = "it already exists" if output.exists() else "its parent folder does not exist"
        raise RequestError(f"--output {output}: {reason}; name a new folder")
    seen: Counter[str] = Counter()
    written: Counter[str] = Counter()
    problems = []
    with TemporaryDirectory(prefix=f".{output.name}.", dir=output.parent) as beside:
        folder = Path(beside) / "whole"
        for split, text, problem in entries:
            if text:
                (folder / split).mkdir(parents=True, exist_ok=True)
                path = folder / split / f"{seen[split]:06}.labyrinth"
                path.write_text(text, encoding="utf-8")
                written[split] += 1
            else:
                problems.append(problem)
            seen[split] += 1
        _explain(problems)
        if not written:
            raise _nothing(source)
        folder.replace(output)
    parts = ", ".join(f"{count:,} of {split}" for split, count in written.items())
    print(printable_line(f"{output}: {parts}"))
    return int(bool(problems))


def _explain(problems: list[str]) -> None:
    more = len(problems) - PROBLEMS_SHOWN
    shown = [*problems[:PROBLEMS_SHOWN], *([f"and {more:,} more"] if more > 0 else [])]
    for line in shown:
        print(printable_line(line), file=sys.stderr)


def _nothing(source: Path) -> RequestError:
    return RequestError(f"{source}: no readable labyrinth; files must end in {', '.join(KINDS)}")
