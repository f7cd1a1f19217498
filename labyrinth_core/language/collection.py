"""Read labyrinths from files of other programs: texts and arrays, in one file or a folder.

Files are never evaluated or unpickled. A labyrinth that cannot be read is reported and skipped.
"""

from __future__ import annotations

import io
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from tokenize import TokenError
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.errors import printable_line
from labyrinth_core.language.source_text import LabyrinthSyntaxError, decode
from labyrinth_core.language.text import dump, parse
from labyrinth_core.language.wall_grid import SIZES, from_connections, from_grid
from labyrinth_core.listing import files_in, why_unreadable
from labyrinth_core.world import Labyrinth, LabyrinthError, Structure

MAX_BYTES = 1 << 28
"""The largest file size."""

ARCHIVES = (".gz", ".npz", ".tar", ".tgz", ".zip")
"""The suffixes of archives, which have to be unpacked first."""


_LINKED = "a link leads to another file here, whose content is not quoted"

_ERRORS_OF_NUMPY = (
    *(ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError),
    *(OSError, EOFError, MemoryError, SyntaxError, TokenError),
)
"""What NumPy raises for the header of an array: it parses any Python literal, and checks little."""


class Entry(NamedTuple):
    """A labyrinth in a file, or the reason why it cannot be read."""

    split: str
    """The split that it belongs to, a valid name for a file or folder."""
    place: str
    """The file, and the index in its array."""
    found: Labyrinth | Structure | None
    """A structure if start and goal are not marked; None if it cannot be read."""
    problem: str = ""
    """Why it cannot be read, in one line that begins with the place."""


class Collection:
    """The labyrinths of a file, or of all files in a folder and its sub-folders, in order.

    The split is the name of the first sub-folder on the path to a file; without a sub-folder it is
    the name of the file, or of the folder for the texts in a folder. Hidden files and folders are
    skipped. A file, folder or link that cannot be read gives a problem, and so does an archive,
    which has to be unpacked first.
    """

    SUFFIXES: ClassVar = (".labyrinth", ".npy")
    """The suffixes of the files that are read."""

    def __init__(self, path: str | Path) -> None:
        """Name the file or folder; it is read when the labyrinths are taken."""
        self.path = Path(path)

    @staticmethod
    def is_at(path: Path) -> bool:
        """Return whether a path can be one: a folder, an array, a text or an archive."""
        return path.is_dir() or path.suffix.lower() in Collection.SUFFIXES + ARCHIVES

    def __iter__(self) -> Iterator[Entry]:
        """Yield each labyrinth, or the reason why it cannot be read.

        Raises:
            OSError: The path does not exist.
        """
        path = self.path
        path.stat()  # Raises if it does not exist.
        folder = path if path.is_dir() else path.parent
        real = path.resolve()
        name = real.name if path.is_dir() else path.stem
        for file, problem in files_in(path) if path.is_dir() else [(path, "")]:
            kind = file.suffix.lower()
            linked = file != path and os.path.realpath(file) != str(real / file.relative_to(path))
            if problem or kind in self.SUFFIXES + ARCHIVES:
                (first, *rest) = file.relative_to(folder).parts or (name,)
                split = first if rest else (name if kind == ".labyrinth" else Path(first).stem)
                shown = printable_line(str(file))  # A file name can hold any character.
                if problem:
                    yield Entry(_safe(split), shown, None, f"{shown}: {problem}")
                else:
                    yield from _entries(file, kind, _safe(split), shown, quotes=not linked)

    def texts(self) -> Iterator[tuple[Entry, str]]:
        """Yield each entry with its labyrinth as text, which is empty if there is a problem.

        Start and goal that are not marked are in their default places.
        """
        for entry in self:
            labyrinth = entry.found
            try:
                if isinstance(labyrinth, Structure):
                    labyrinth = Labyrinth(labyrinth, *labyrinth.default_ends)
            except LabyrinthError as error:  # No route joins the default start and goal.
                yield entry._replace(found=None, problem=f"{entry.place}: {error}"), ""
            else:
                yield entry, "" if labyrinth is None else dump(labyrinth)

    def write_texts(self, folder: Path) -> tuple[Counter[str], list[str]]:
        """Write each labyrinth as a .labyrinth file, by split, named by its number in the split.

        Returns:
            The number of labyrinths written by split, and all problems.
        """
        read, written = Counter[str](), Counter[str]()
        problems = []
        for entry, text in self.texts():
            split = entry.split
            if text:
                (folder / split).mkdir(parents=True, exist_ok=True)
                path = folder / split / f"{read[split]:06}.labyrinth"
                path.write_text(text, encoding="utf-8")
                written[split] += 1
            else:
                problems.append(entry.problem)
            read[split] += 1
        return written, problems


def read_collection(path: str | Path) -> Iterator[Entry]:
    """Yield the labyrinths of a file or folder: `iter(Collection(path))`.

    Raises:
        OSError: The path does not exist.
    """
    return iter(Collection(path))


def _entries(file: Path, kind: str, split: str, place: str, *, quotes: bool) -> Iterator[Entry]:
    """Yield the labyrinths of a file.

    Args:
        file: The file.
        kind: Its suffix in lower case.
        split: The split that its labyrinths belong to.
        place: Its name, for messages.
        quotes: Whether a problem may quote the file, which may be any file if links lead to it.
    """
    try:
        data = _bytes(file)
        if kind == ".labyrinth":
            yield _entry(split, place, lambda: _parse(data, str(file), quotes=quotes))
        else:
            for index, read in _in_array(_array(data, quotes=quotes)):
                yield _entry(split, place + index, read)
    except OSError as error:
        yield Entry(split, place, None, f"{place}: {why_unreadable(file, error)}")
    except ValueError as error:
        yield Entry(split, place, None, f"{place}: {_line(error)}")


def _bytes(file: Path) -> bytes:
    """Return the bytes of a file, which has at most `MAX_BYTES`.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is larger, or an archive.
    """
    with file.open("rb") as stream:
        if file.suffix.lower() in ARCHIVES:
            raise ValueError("unpack this archive and give the folder")
        data = stream.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise ValueError(f"it has more than {MAX_BYTES:,} bytes")
    return data


def _entry(split: str, place: str, read: Callable[[], Labyrinth | Structure]) -> Entry:
    try:
        return Entry(split, place, read())
    except LabyrinthSyntaxError as error:  # Its message begins with the place.
        return Entry(split, place, None, str(error).partition("\n")[0])
    except ValueError as error:
        return Entry(split, place, None, f"{place}: {_line(error)}")


def _in_array(array: NDArray[Any]) -> Iterator[tuple[str, Callable[[], Labyrinth | Structure]]]:
    """Yield the index of each labyrinth of an array, and a function that reads it."""
    if array.ndim == 2:
        yield "", partial(from_grid, array)
    elif array.ndim == 3 or (array.ndim == 4 and array.shape[1] == 2):
        read = from_grid if array.ndim == 3 else from_connections
        for index, each in enumerate(array):
            yield f"[{index}]", partial(read, each)
    else:
        raise ValueError(
            f"an array of shape {array.shape}: expected a wall grid ({SIZES}), several "
            "of them (n, 2h + 1, 2w + 1), or connections of maze-dataset (n, 2, rows, columns)"
        )


def _parse(data: bytes, name: str, *, quotes: bool) -> Labyrinth:
    """Return the labyrinth in the bytes of a text."""
    try:
        return parse(decode(data, name), file=name)
    except LabyrinthSyntaxError as error:
        if quotes:
            raise
        raise replace(error, message=_LINKED, expected=None, found=None) from None


def _array(data: bytes, *, quotes: bool) -> NDArray[Any]:
    """Return the booleans or numbers in the bytes of a .npy file."""
    try:
        array: NDArray[Any] = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    except _ERRORS_OF_NUMPY as error:
        reason = str(error) if quotes else _LINKED
        raise ValueError(f"the array cannot be read: {reason}") from error
    if not array.size:
        raise ValueError(f"an empty array of shape {array.shape}")
    if array.dtype.kind not in "biuf":
        raise ValueError(f"expected an array of booleans or numbers, found {array.dtype}")
    return array


def _line(error: ValueError) -> str:
    return " ".join(str(error).split())


def _safe(name: str) -> str:
    """Turn any text into a valid name for a file or folder."""
    return re.sub(r"[^\w.-]+", "-", name).strip("-.") or "labyrinths"
