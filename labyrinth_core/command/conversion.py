"""`labyrinth convert` for arrays and folders: write their labyrinths as text."""

from __future__ import annotations

import sys
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

from labyrinth_core.command.arguments import RequestError
from labyrinth_core.errors import printable_line
from labyrinth_core.language import Collection

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
    collection = Collection(source)
    if output is not None:
        return _write(collection, output)
    few = list(islice(collection.texts(), 2))
    if len(few) > 1:
        raise RequestError(f"{source} holds several labyrinths: give --output FOLDER")
    if not few:
        raise _nothing(source)
    ((entry, text),) = few
    sys.stdout.write(text)
    _explain([entry.problem] if entry.problem else [])
    return int(bool(entry.problem))


def _write(collection: Collection, output: Path) -> int:
    if output.exists() or not output.parent.is_dir():
        reason = "it already exists" if output.exists() else "its parent folder does not exist"
        raise RequestError(f"--output {output}: {reason}; name a new folder")
    with TemporaryDirectory(prefix=f".{output.name}.", dir=output.parent) as beside:
        folder = Path(beside) / "whole"
        written, problems = collection.write_texts(folder)
        _explain(problems)
        if not written:
            raise _nothing(collection.path)
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
    return RequestError(
        f"{source}: no readable labyrinth; files must end in {', '.join(Collection.SUFFIXES)}"
    )
