"""The labyrinths of datasets from elsewhere: files in folders, or any dataset with `info`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.source import stream_infos
from labyrinth_core.language.text import labyrinth_id, load, parse
from labyrinth_core.world.labyrinth import Labyrinth

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
        split, labyrinth = path.parent.name, _loaded(path)
        splits.setdefault(split, []).append(labyrinth)
        files.setdefault(split, {}).setdefault(labyrinth_id(labyrinth), str(path))
    if not splits:
        streams = stream_infos(str(folder) if folder.is_dir() else source, config)
        splits = {split: _parsed(split, infos) for split, infos in streams.items()}
    return splits, files


def _loaded(path: Path) -> Labyrinth:
    try:
        return load(path)
    except ValueError as error:  # It begins with the path and the place in it.
        raise DatasetError(str(error).partition("\n")[0]) from error


def _parsed(split: str, infos: Iterable[str]) -> list[Labyrinth]:
    labyrinths = []
    for info in dict.fromkeys(infos):
        try:
            labyrinths.append(parse(info))
        except ValueError as error:
            reason = str(error).partition("\n")[0]
            raise DatasetError(f"{split} info: no labyrinth: {reason}") from error
    return labyrinths
