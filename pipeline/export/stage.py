"""The stage `export`: splits of a dataset in the format of another library, each whole or absent.

A split is written in a folder beside its own, and moved there once finished; a run that was stopped
begins with the split that was not. An export with files that are damaged or missing, by their
hashes in its SHA256SUMS, is made anew.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from labyrinth_core.data.dataset import locate
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.manifest import TABLE
from labyrinth_core.data.storage import temporary_beside, write_text
from pipeline.config.errors import check, listed
from pipeline.config.export import EXPORTS, RECORD
from pipeline.config.run import Run
from pipeline.export.split import Split
from pipeline.inspection import front_matter
from pipeline.machinery.console import say
from pipeline.machinery.dataset import manifest_of
from pipeline.machinery.folders import (
    followed,
    held,
    move_into_place,
    recover,
    remove,
    wait_for_disk,
)
from pipeline.machinery.own_files import HASHES, OwnFiles, is_litter, list_all

README = "README.md"
"""The card of all datasets of a folder, which may name their licence."""


def run(run: Run) -> None:
    """Export the splits that are asked for, or all.

    Raises:
        ConfigError: A split is missing, or a library; or something else is where an export is to
            be.
        DatasetError: There is no such dataset, or it is damaged, or an export cannot be written.
    """
    asked = run.options.export
    write = _writer(asked.format)
    root = Path(asked.folder).expanduser() / asked.format
    splits = splits_of(run)
    targets = [followed(root / split.id) for split in splits]
    for target, split in zip(targets, splits, strict=True):
        _left_at(target, split, overwrite=run.options.overwrite)
    for target, split in zip(targets, splits, strict=True):
        with held(target.parent, target.name):
            recover(target, HASHES)
            own = _left_at(target, split, overwrite=run.options.overwrite)
            damaged = sorted({name for name, _ in own.hashes if not own.has(name)})
            there = bool(own.hashes) and not damaged and _record(target) == split.record()
            if not there:
                _check_replaceable(target, own)
                with _made_whole(target) as folder:
                    write(split, folder)
                    write_text(folder / RECORD, json.dumps(split.record(), indent=2) + "\n")
                    list_all(folder)
        state = "is there already" if there else f"has {split.count:,} episodes"
        again = f"; made anew, as damaged or missing: {', '.join(damaged)}" if damaged else ""
        say(f"{target} {state}{again}")


def _writer(format_: str) -> Callable[[Split, Path], None]:
    """Return what writes a split into an empty folder, in a format."""
    module = import_module(EXPORTS[format_])
    missing = [name for name in getattr(module, "NEEDS", ()) if find_spec(name) is None]
    check(
        not missing,
        f"export.format={format_} needs {' and '.join(missing)}: "
        f"pip install 'labyrinth-datasets[{format_}]'",
    )
    write: Callable[[Split, Path], None] = module.write
    return write


def splits_of(run: Run) -> list[Split]:
    """Return the splits to export; raise as `run`."""
    asked, options = run.options.export, run.options
    manifest = manifest_of(run)
    names = list(dict.fromkeys(shard.split for shard in manifest.shards))
    unknown = [name for name in asked.splits if name not in names]
    check(not unknown, f"export.splits={listed(asked.splits)}: choose from {listed(names)}")
    files = [TABLE, f"../{README}"]
    folder = locate(run.source, manifest.config.name, files, options.revision)
    values, _ = front_matter.read(folder.parent / README)
    return [
        Split(
            source=run.source,
            revision=options.revision,
            folder=folder,
            manifest=manifest,
            name=name,
            image_size=asked.image_size,
            licence=front_matter.licence_of(values),
        )
        for name in names
        if not asked.splits or name in asked.splits
    ]


def _left_at(target: Path, split: Split, *, overwrite: bool) -> OwnFiles:
    """Return the files of the export at a place, none where nothing is there.

    Raises:
        ConfigError: Something else is there, or another export that is not to be replaced.
        DatasetError: There is a SHA256SUMS of another program.
    """
    own = OwnFiles.read(target, always=RECORD)
    check(
        target.is_dir() or not target.exists(),
        f"{target} is a file: move it elsewhere, or choose another export.folder",
    )
    if own.has(RECORD) and _record(target) == split.record():
        return own
    _check_replaceable(target, own)
    check(
        overwrite or not own.has(RECORD),
        f"{target} is an export of another dataset, or with other options: overwrite=true replaces "
        "it",
    )
    return own


def _check_replaceable(target: Path, own: OwnFiles) -> None:
    """Raise ConfigError if a file of a user is in the folder of an export."""
    names = {target / name for name, _ in own.hashes} | {target / HASHES}
    folders = {folder for path in names for folder in path.parents}
    for path in sorted(target.rglob("*")):
        name = path.relative_to(target)
        is_own = (path in names and path.is_file()) or (path in folders and path.is_dir())
        check(
            is_own or is_litter(name),
            f"{target} holds {name}, which no export has: move it elsewhere, or choose another "
            "export.folder",
        )


def _record(target: Path) -> object:
    """Return what an export says of itself."""
    return json.loads((target / RECORD).read_bytes())


@contextmanager
def _made_whole(target: Path) -> Iterator[Path]:
    """Lend an empty folder, which is moved to a place at the end, or removed after an error."""
    folder = temporary_beside(target.absolute())
    try:
        folder.mkdir(parents=True)
        yield folder
        wait_for_disk(folder)
        move_into_place(folder, target, HASHES)
    except DatasetError:
        raise
    except (OSError, RuntimeError) as error:  # Of h5py, either.
        reason = getattr(error, "strerror", None) or one_line(error)
        raise DatasetError(f"{target} cannot be written: {reason}") from error
    finally:
        remove(folder)
