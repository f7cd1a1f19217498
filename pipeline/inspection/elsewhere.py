"""Labyrinths of datasets from elsewhere: in files by split, or in the column `info`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.source import stream_infos
from labyrinth_core.language.collection import KINDS, is_collection, read_collection
from labyrinth_core.language.text import parse
from labyrinth_core.world.labyrinth import Labyrinth, Structure
from pipeline.inspection.certificate import Held, ids_of, structure_of


@dataclass(frozen=True)
class Elsewhere:
    """What was found in a dataset from elsewhere."""

    splits: Mapping[str, Sequence[Held]]
    """Split -> its labyrinths, in order; or their structures, if one has neither start nor goal."""
    files: Mapping[str, Mapping[str, str]]
    """Split -> id of a labyrinth -> its first place in a file; empty if they are in no files."""
    problems: Sequence[str]
    """A line for each labyrinth, or file, that could not be read."""

    @property
    def structures_alone(self) -> bool:
        """Whether the splits hold structures."""
        return any(isinstance(held[0], Structure) for held in self.splits.values() if held)

    @property
    def copies(self) -> dict[str, int]:
        """Split -> number of labyrinths in it that came before, with the same start and goal."""
        return {split: len(held) - len(set(held)) for split, held in self.splits.items()}


def read_elsewhere(source: str, config: str | None) -> Elsewhere:
    """Return the labyrinths of a dataset from elsewhere.

    Args:
        source: A file or a folder for `read_collection`; or a dataset with a column `info`, as
            `load_dataset` finds it: in a folder with Parquet files, or by its id on the Hub. No
            other column is read.
        config: The config of the dataset, if it has several.

    Raises:
        DatasetError: The source is none of these, or no labyrinth in it can be read.
        OSError: A file cannot be read.
    """
    path = Path(source).expanduser()
    if path.is_file() and not is_collection(path):
        raise DatasetError(f"{source}: labyrinths are in files that end in {', '.join(KINDS)}")
    if path.is_file() or (path.is_dir() and next(path.rglob("*.parquet"), None) is None):
        found = _in_files(path)
        if found.splits:
            return found
        if found.problems or path.is_file():
            raise DatasetError(next(iter(found.problems), f"{source} holds no labyrinth"))
    streams = stream_infos(str(path) if path.is_dir() else source, config)
    # The pieces of a route are episodes of one labyrinth, each with a text of its own.
    splits = {split: [*dict.fromkeys(_parsed(infos, split))] for split, infos in streams.items()}
    return Elsewhere(splits, {}, ())


def _in_files(path: Path) -> Elsewhere:
    """Return the labyrinths in a file or a folder."""
    entries = list(read_collection(path))
    found = [
        (split, place, _from_start(each)) for split, place, each, _ in entries if each is not None
    ]
    alone = any(isinstance(each, Structure) for _, _, each in found)
    splits: dict[str, list[Held]] = {}
    places: dict[str, list[str]] = {}
    for split, place, each in found:
        splits.setdefault(split, []).append(structure_of(each) if alone else each)
        places.setdefault(split, []).append(place)
    files: dict[str, dict[str, str]] = {split: {} for split in splits}
    for split, held in splits.items():
        for number, place in zip(ids_of(held), places[split], strict=True):
            files[split].setdefault(f"{number:016x}", place)
    return Elsewhere(splits, files, [entry.problem for entry in entries if entry.problem])


def _from_start(found: Held) -> Held:
    return found.from_start() if isinstance(found, Labyrinth) else found


def _parsed(infos: Iterator[str], split: str) -> Iterator[Labyrinth]:
    for info in dict.fromkeys(infos):
        try:
            yield parse(info).from_start()
        except ValueError as error:
            # Its first line says what is wrong, those below show the place.
            reason = str(error).partition("\n")[0]
            raise DatasetError(f"{split} info: no labyrinth: {reason}") from error
