"""The labyrinths of datasets from elsewhere: files in folders, or any dataset with `info`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.source import stream_infos
from labyrinth_core.language.text import labyrinth_id, load, parse
from labyrinth_core.world.labyrinth import Labyrinth

Source = TypeVar("Source", str, Path)

Files = dict[str, dict[str, str]]
"""Split -> id of a labyrinth -> path of the file it is in."""


def labyrinths_of(source: str, config: str | None) -> tuple[dict[str, list[Labyrinth]], Files]:
    """Return the labyrinths of each split, in order, and their files, if they are in files.

    Only the column `info` of a dataset is read.

    Args:
        source: A folder with a folder of `.labyrinth` files for each split; or a dataset with a
            column `info`, as `load_dataset` finds it: in a folder, or by its id on the Hub.
        config: The config of the dataset, if it has several.

    Raises:
        DatasetError: The source is neither, or a text in it does not describe a labyrinth.
    """
    folder = Path(source).expanduser()
    splits: dict[str, list[Labyrinth]] = {}
    files: Files = {}
    for path in sorted(folder.glob("*/*.labyrinth")):
        split, labyrinth = path.parent.name, _read(load, path)
        splits.setdefault(split, []).append(labyrinth)
        files.setdefault(split, {}).setdefault(labyrinth_id(labyrinth), str(path))
    if not splits:
        streams = stream_infos(str(folder) if folder.is_dir() else source, config)
        splits = {
            split: [
                _read(parse, info, f"{split} info: no labyrinth: ") for info in dict.fromkeys(infos)
            ]
            for split, infos in streams.items()
        }
    return splits, files


def _read(read: Callable[[Source], Labyrinth], source: Source, where: str = "") -> Labyrinth:
    try:
        return read(source)
    except ValueError as error:  # Its first line says what is wrong, those below show the place.
        raise DatasetError(f"{where}{error}".partition("\n")[0]) from error
