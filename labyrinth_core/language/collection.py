"""Labyrinths in the files that others have: one file, a folder of them, or an archive.

Nothing in a file is evaluated or unpickled. What cannot be read is told with its place, and the
rest is read.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from labyrinth_core.language.maze_dataset import from_connections, stored_mazes
from labyrinth_core.language.source_text import LabyrinthSyntaxError, decode, printable
from labyrinth_core.language.stored_arrays import (
    MAX_BYTES,
    limited,
    open_archive,
    read_array,
    read_member,
)
from labyrinth_core.language.text import parse
from labyrinth_core.language.wall_grid import SIZES, from_grid
from labyrinth_core.language.wall_picture import from_picture
from labyrinth_core.world.labyrinth import Labyrinth, Structure

SINGLE = (".labyrinth", ".png")
"""The endings of files that hold one labyrinth."""
ARCHIVES = {".npz": (".npy",), ".zip": (*SINGLE, ".npy", ".npz", ".zanj")}
"""The endings of archives, and those of the files in them that are read: never one like it."""
KINDS = (*ARCHIVES[".zip"], ".zip")
"""The endings of files in which labyrinths are found."""

Read = Callable[[], Labyrinth | Structure]
Reader = tuple[str, Read]
"""The index of a labyrinth in a file, and what reads it."""


class Entry(NamedTuple):
    """A labyrinth in a file, or the reason why it cannot be read."""

    split: str
    """The split that it belongs to, a name that files and folders can have."""
    place: str
    """The file, and within it the name of the array and the index."""
    found: Labyrinth | Structure | None
    """A structure if nothing says where start and goal are; None if it cannot be read."""
    problem: str = ""
    """Why, in a line that begins with the place."""


def is_collection(path: Path) -> bool:
    """Return whether a path is that of a folder, or of a file whose ending says what it holds."""
    return path.is_dir() or path.suffix.lower() in KINDS


def read_collection(path: Path) -> Iterator[Entry]:
    """Yield the labyrinths of a file, or of all files in a folder and its sub-folders, in order.

    A zip archive is like a folder, and an .npz file like one of .npy files. The split is the name
    of the sub-folder that a file lies in; without one it is that of the file, or of the folder if
    the file holds a single labyrinth.

    Raises:
        OSError: A file cannot be read.
    """
    folder = path if path.is_dir() else path.parent
    files = sorted([*path.glob("*"), *path.glob("*/*")]) if path.is_dir() else [path]
    name = path.resolve().name if path.is_dir() else path.stem
    for file in files:
        if file == path or file.is_file():
            inner = PurePosixPath(file.relative_to(folder).as_posix())
            yield from _of_file(_File(str(file), None, name, inner, partial(_content, file)), KINDS)


class _File(NamedTuple):
    """A file to read, in a folder or in an archive."""

    place: str
    """Its path, for messages."""
    split: str | None
    """The split of everything in it, None if names tell."""
    folder: str
    """The name of the folder or archive."""
    path: PurePosixPath
    """Its path in that."""
    read: Callable[[], bytes]
    """Returns its bytes."""


def _content(path: Path) -> bytes:
    with path.open("rb") as stream:
        return limited(stream.read(MAX_BYTES + 1))


def _of_file(file: _File, kinds: Collection[str]) -> Iterator[Entry]:
    """Yield the labyrinths of a file, nothing if its ending is none of the given ones."""
    kind = file.path.suffix.lower()
    if kind not in kinds or file.path.name.startswith("."):
        return
    place = printable(file.place).replace("\n", "\\n")  # A name may be any text.
    split = file.split or file.path.parent.name or None
    named = _safe(split or (file.folder if kind in SINGLE else file.path.stem))
    try:
        data = file.read()
        if kind not in ARCHIVES:
            for where, reader in _READERS[kind](data, place):
                yield _entry(named, f"{place}{where}", reader)
            return
        archive = open_archive(data)
        for name in sorted(archive.namelist()):
            member = partial(read_member, archive, name)
            inner = _File(f"{place}: {name}", split, named, PurePosixPath(name), member)
            yield from _of_file(inner, ARCHIVES[kind])
    except ValueError as error:
        yield Entry(named, place, None, f"{place}: {_line(error)}")


def _text(data: bytes, place: str) -> Iterator[Reader]:
    yield "", lambda: parse(decode(data, place), file=place)


def _picture(data: bytes, _: str) -> Iterator[Reader]:
    yield "", partial(from_picture, data)


def _mazes(data: bytes, _: str) -> Iterator[Reader]:
    for index, maze in enumerate(stored_mazes(data)):
        yield f"[{index}]", partial(from_connections, *maze)


def _arrays(data: bytes, _: str) -> Iterator[Reader]:
    array = read_array(data)
    if array.ndim == 2:
        yield "", partial(from_grid, array)
    elif array.ndim == 3 or (array.ndim == 4 and array.shape[1] == 2):
        read = from_grid if array.ndim == 3 else from_connections
        for index, each in enumerate(array):
            yield f"[{index}]", partial(read, each)
    else:
        raise ValueError(
            f"an array of the shape {array.shape}: expected a wall grid ({SIZES}), several "
            "of them (n before that), or connections of maze-dataset (n, 2, rows, columns)"
        )


_READERS = {
    ".labyrinth": _text,
    ".png": _picture,
    ".zanj": _mazes,
    ".npy": _arrays,
}


def _entry(split: str, place: str, read: Read) -> Entry:
    try:
        return Entry(split, place, read())
    except LabyrinthSyntaxError as error:  # It names the place itself.
        return Entry(split, place, None, str(error).partition("\n")[0])
    except ValueError as error:
        return Entry(split, place, None, f"{place}: {_line(error)}")


def _line(error: ValueError) -> str:
    return " ".join(str(error).split())


def _safe(name: str) -> str:
    """Return a name that files and folders can have, for one that may be any text."""
    return re.sub(r"[^\w.-]+", "-", name).strip("-.") or "labyrinths"
