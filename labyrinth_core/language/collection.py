"""Labyrinths in files of others: texts and arrays, alone, in a folder or in an archive.

Nothing in a file is evaluated or unpickled. Each labyrinth that cannot be read is reported with its
place, and the others are read.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import partial
from pathlib import Path, PurePosixPath
from tokenize import TokenError
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.language.reading import (
    open_archive,
    read_at_most,
    regular_file,
    unpack,
)
from labyrinth_core.language.source_text import LabyrinthSyntaxError, decode, printable
from labyrinth_core.language.text import parse
from labyrinth_core.language.wall_grid import SIZES, from_connections, from_grid
from labyrinth_core.world.labyrinth import Labyrinth, Structure

MAX_BYTES = 1 << 28
"""The largest size of a file, and of each file in an archive once it is unpacked."""

ARCHIVES = {".npz": (".npy",), ".zip": (".labyrinth", ".npy", ".npz")}
"""The endings of archives, and of the files in them that are read: never another of its kind."""
KINDS = (*ARCHIVES[".zip"], ".zip")
"""The endings of the files that are read."""


class Entry(NamedTuple):
    """A labyrinth in a file, or the reason why it cannot be read."""

    split: str
    """The split that it belongs to, a name that files and folders can have."""
    place: str
    """The file, and within it the name of the array and the index."""
    found: Labyrinth | Structure | None
    """A structure if start and goal are not marked; None if it cannot be read."""
    problem: str = ""
    """Why it cannot be read, in a line that begins with the place."""


def is_collection(path: Path) -> bool:
    """Return whether a path is a folder, or a file with one of the endings that are read."""
    return path.is_dir() or path.suffix.lower() in KINDS


def files_in(folder: Path) -> list[Path]:
    """Return the files in a folder and in its sub-folders, in order; none if it does not exist.

    A name that begins with a dot hides a file, and a folder with all that is in it, such as `.git`
    or the copies in `.ipynb_checkpoints`. Links are followed.

    Raises:
        OSError: A folder cannot be read.
    """
    files = []
    folders = [(folder, frozenset({folder.resolve()}))] if folder.is_dir() else []
    for each, above in folders:  # The list grows during the loop.
        for path in each.iterdir():
            if not _is_hidden(path.name) and path.is_file():
                files.append(path)
            elif not _is_hidden(path.name) and path.is_dir():
                real = path.resolve()
                if real not in above:  # Or a link would lead round for ever.
                    folders.append((path, above | {real}))
    return sorted(files)


def read_collection(path: Path, *, max_bytes: int = MAX_BYTES) -> Iterator[Entry]:
    """Yield the labyrinths of a file, or of all files in a folder and its sub-folders, in order.

    A zip archive is read like a folder, and an .npz file like a folder of .npy files. The split is
    the name of the first sub-folder on the way to a file; without one it is the name of the file,
    or of the folder if the file is a text. Hidden files and folders are left out.

    Args:
        path: The file or folder.
        max_bytes: The size from which on a file is refused, also a file in an archive.

    Raises:
        OSError: A file or a folder cannot be read.
    """
    folder = path if path.is_dir() else path.parent
    name = path.resolve().name if path.is_dir() else path.stem
    for file in files_in(path) if path.is_dir() else [path]:
        inner = PurePosixPath(file.relative_to(folder).as_posix())
        opened = partial(regular_file(file).open, "rb")
        read = partial(read_at_most, opened, max_bytes)
        yield from _entries(_File(str(file), None, name, inner, read), KINDS, max_bytes)


class _File(NamedTuple):
    """A file to read, in a folder or in an archive."""

    place: str
    """Its path, for messages."""
    split: str | None
    """The split of everything in it, None if names tell."""
    folder: str
    """The name of the folder or archive."""
    path: PurePosixPath
    """Its path in that folder or archive."""
    read: Callable[[], bytes]
    """Returns its bytes."""


def _entries(file: _File, kinds: Collection[str], max_bytes: int) -> Iterator[Entry]:
    """Yield the labyrinths of a file, nothing if it has none of the given endings."""
    kind = file.path.suffix.lower()
    if kind not in kinds:
        return
    place = printable(file.place).replace("\n", "\\n")  # A name may be any text.
    split = file.split or next(iter(file.path.parts[:-1]), None)
    named = _safe(split or (file.folder if kind == ".labyrinth" else file.path.stem))
    try:
        data = file.read()
        if kind == ".labyrinth":
            yield _entry(named, place, lambda: parse(decode(data, place), file=place))
        elif kind == ".npy":
            for index, read in _in_array(_array(data)):
                yield _entry(named, place + index, read)
        else:
            archive = open_archive(io.BytesIO(data))
            for name, path in _members(archive.namelist(), file.path.stem):
                member = partial(unpack, archive, name, max_bytes)
                inner = _File(f"{place}: {name}", split, named, path, member)
                yield from _entries(inner, ARCHIVES[kind], max_bytes)
    except ValueError as error:
        yield Entry(named, place, None, f"{place}: {_line(error)}")


def _members(names: Iterable[str], packed: str) -> Iterator[tuple[str, PurePosixPath]]:
    """Yield the name of each file in an archive that is not hidden, and its path.

    If all of them are in a folder of the archive's own name, that folder was packed, and the paths
    to its sub-folders begin in it.
    """
    paths = {name: PurePosixPath(name.lstrip("/")) for name in names if not name.endswith("/")}
    shown = {name: path for name, path in paths.items() if not any(map(_is_hidden, path.parts))}
    within = all(path.is_relative_to(packed) for path in shown.values())
    for name, path in sorted(shown.items()):
        yield name, path.relative_to(packed) if within and len(path.parts) > 2 else path


def _is_hidden(name: str) -> bool:
    """Return whether a name hides a file or a folder."""
    return name.startswith(".") and name != ".."


def _entry(split: str, place: str, read: Callable[[], Labyrinth | Structure]) -> Entry:
    try:
        return Entry(split, place, read())
    except LabyrinthSyntaxError as error:  # It names the place itself.
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
            f"an array of the shape {array.shape}: expected a wall grid ({SIZES}), several "
            "of them (n before that), or connections of maze-dataset (n, 2, rows, columns)"
        )


def _array(data: bytes) -> NDArray[Any]:
    """Return the booleans or numbers in the bytes of a .npy file."""
    try:
        array: NDArray[Any] = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OSError, EOFError, MemoryError, SyntaxError, TokenError) as error:
        # Its header may claim anything; numpy parses it as the text of a literal.
        raise ValueError(f"no array that can be read: {error}") from error
    if not array.size:
        raise ValueError(f"an array of the shape {array.shape}, which holds nothing")
    if array.dtype.kind not in "biuf":
        raise ValueError(f"expected an array of booleans or numbers, found {array.dtype}")
    return array


def _line(error: ValueError) -> str:
    return " ".join(str(error).split())


def _safe(name: str) -> str:
    """Return a name that files and folders can have, made from any text."""
    return re.sub(r"[^\w.-]+", "-", name).strip("-.") or "labyrinths"
