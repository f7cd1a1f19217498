"""Read labyrinths from files of other programs: texts and arrays, in one file or a folder.

Files are never evaluated or unpickled. A labyrinth that cannot be read is reported and skipped.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path, PurePath
from tokenize import TokenError
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.language.source_text import LabyrinthSyntaxError, decode, printable
from labyrinth_core.language.text import parse
from labyrinth_core.language.wall_grid import SIZES, from_connections, from_grid
from labyrinth_core.world.labyrinth import Labyrinth, Structure

MAX_BYTES = 1 << 28
"""The largest file size."""

KINDS = (".labyrinth", ".npy")
"""The suffixes of the files that are read."""
ARCHIVES = (".gz", ".npz", ".tar", ".tgz", ".zip")
"""The suffixes of archives, which have to be unpacked first."""


LITTER = (
    *(".ds_store", "._*", "thumbs.db", "desktop.ini", ".directory", "__macosx"),
    *("@eadir", "@recycle", "#recycle", "$recycle.bin", "system volume information", "lost+found"),
    *(".trash*", ".stfolder", ".spotlight-v100", ".fseventsd", ".temporaryitems", ".appledouble"),
    *("#snapshot", "@recently-snapshot", ".snapshot", ".snapshots", ".@__thumb", ".syncthing.*"),
    *(".nfs*", ".fuse_hidden*"),
    *(".ipynb_checkpoints", "cache-*.arrow"),
)
"""Patterns, in lower case, of files and folders that desktops, storage servers, network file
systems and readers (Jupyter, `datasets`) leave anywhere."""


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


def is_collection(path: Path) -> bool:
    """Return whether a path is for `read_collection`: a folder, an array, a text or an archive."""
    return path.is_dir() or path.suffix.lower() in KINDS + ARCHIVES


def is_litter(path: str | PurePath) -> bool:
    """Return whether a path relative to a folder matches `LITTER`, files that no user misses."""
    parts = [part.lower() for part in PurePath(path).parts]
    return any(fnmatchcase(part, pattern) for part in parts for pattern in LITTER)


def files_in(folder: Path) -> list[Path]:
    """Return the files in a folder and its sub-folders, sorted; [] if it does not exist.

    Files and folders whose names begin with a dot, such as `.git` or `.ipynb_checkpoints`, and
    those that systems leave, such as `@eaDir`, are skipped. Links are followed.

    Raises:
        OSError: A folder cannot be read.
    """
    files = []
    folders = [(folder, frozenset({folder.resolve()}))] if folder.is_dir() else []
    for each, above in folders:  # The list grows during the loop.
        for path in each.iterdir():
            if path.name.startswith(".") or is_litter(path.name):
                continue
            if path.is_file():
                files.append(path)
            elif path.is_dir():
                real = path.resolve()
                if real not in above:  # A link to a folder above would never end.
                    folders.append((path, above | {real}))
    return sorted(files)


def read_collection(path: str | Path) -> Iterator[Entry]:
    """Yield the labyrinths of a file, or of all files in a folder and its sub-folders, in order.

    The split is the name of the first sub-folder on the path to a file; without a sub-folder it is
    the name of the file, or of the folder for the texts in a folder. Hidden files and folders are
    skipped. An archive yields a problem: it has to be unpacked first.

    Raises:
        OSError: A file or a folder cannot be read.
    """
    path = Path(path)
    path.stat()  # Raises if it does not exist.
    folder = path if path.is_dir() else path.parent
    name = path.resolve().name if path.is_dir() else path.stem
    for file in files_in(path) if path.is_dir() else [path]:
        kind = file.suffix.lower()
        if kind in KINDS + ARCHIVES:
            (first, *rest) = file.relative_to(folder).parts
            split = first if rest else (name if kind == ".labyrinth" else file.stem)
            yield from _entries(file, kind, _safe(split))


def _entries(file: Path, kind: str, split: str) -> Iterator[Entry]:
    """Yield the labyrinths of a file; `kind` is its suffix in lower case."""
    place = printable(str(file)).replace("\n", "\\n")  # A file name can hold any character.
    try:
        data = _bytes(file)
        if kind == ".labyrinth":
            yield _entry(split, place, lambda: parse(decode(data, place), file=place))
        else:
            for index, read in _in_array(_array(data)):
                yield _entry(split, place + index, read)
    except ValueError as error:
        yield Entry(split, place, None, f"{place}: {_line(error)}")


def _bytes(file: Path) -> bytes:
    """Return the bytes of a file, which has at most `MAX_BYTES`.

    Raises:
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


def _array(data: bytes) -> NDArray[Any]:
    """Return the booleans or numbers in the bytes of a .npy file."""
    try:
        array: NDArray[Any] = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OSError, EOFError, MemoryError, SyntaxError, TokenError) as error:
        # The header may hold anything; NumPy parses it as a Python literal.
        raise ValueError(f"the array cannot be read: {error}") from error
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
