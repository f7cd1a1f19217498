"""The stage `export`: splits of a dataset in the format of another library, each whole or absent.

A split is written in `.NAME.exporting` beside its folder, and moved there once finished; a run that
was stopped begins with the split that was not.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from labyrinth_core.data.errors import DatasetError, lacks_memory, one_line
from labyrinth_core.data.labyrinth_table import TABLE
from labyrinth_core.data.source import locate
from labyrinth_core.data.storage import write_text
from pipeline.config.errors import ConfigError, check, listed
from pipeline.config.export import EXPORTS
from pipeline.config.run import Run
from pipeline.export.split import Split
from pipeline.inspection import front_matter
from pipeline.machinery.console import say
from pipeline.machinery.dataset import manifest_of
from pipeline.machinery.folders import held, move_into_place, recover, wait_for_disk

RECORD = "labyrinth.json"
"""The file in the folder of each export that says where it comes from; written last."""

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
    for split in splits:
        _is_there(root / split.id, split, overwrite=run.options.overwrite)
    for split in splits:
        target = root / split.id
        with held(target.parent, target.name):
            recover(target)
            there = _is_there(target, split, overwrite=run.options.overwrite)
            if not there:
                with _made_whole(target) as folder:
                    write(split, folder)
                    write_text(folder / RECORD, json.dumps(split.record(), indent=2) + "\n")
        state = "is there already" if there else f"has {split.count:,} episodes"
        say(f"{target} {state}")


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


def _is_there(target: Path, split: Split, *, overwrite: bool) -> bool:
    """Return whether an export is finished; raise ConfigError if something else is in its place."""
    if not target.exists():
        return False
    try:
        record = json.loads((target / RECORD).read_bytes())
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"{target} is no export: move it elsewhere, or choose another export.folder"
        ) from error
    if record == split.record():
        return True
    check(
        overwrite,
        f"{target} is an export of another dataset, or with other options: overwrite=true replaces "
        "it",
    )
    return False


@contextmanager
def _made_whole(target: Path) -> Iterator[Path]:
    """Lend an empty folder, which is moved to a place at the end, or removed after an error."""
    folder = target.with_name(f".{target.name}.exporting")
    shutil.rmtree(folder, ignore_errors=True)
    try:
        folder.mkdir(parents=True)
        yield folder
        wait_for_disk(folder)
        move_into_place(folder, target)
    except DatasetError:
        raise
    except (OSError, RuntimeError) as error:  # Of h5py, either.
        if lacks_memory(error):
            raise
        reason = getattr(error, "strerror", None) or one_line(error)
        raise DatasetError(f"{target} cannot be written: {reason}") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)
