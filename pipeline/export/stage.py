"""The stage `export`: write splits of a dataset in the format of another library."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from labyrinth_core.data import Manifest
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.storage import File
from pipeline.config import ExportOptions, Job, check
from pipeline.export.options import ExportStageOptions
from pipeline.export.split import Split
from pipeline.inspection import front_matter
from pipeline.machinery import Ownership, Sums, produced, say

README = "README.md"
"""The card of the datasets in a folder, which may name their licence."""
INSTEAD = "choose another export.folder"


def run(job: Job[ExportStageOptions]) -> None:
    """Export the splits in `export.splits`, or all.

    Raises:
        ConfigError: A split does not exist, or a library is not installed.
        DatasetError: The dataset does not exist or is damaged, an export cannot be written, or its
            folder holds something else.
    """
    asked, overwrite = job.options.export, job.options.overwrite
    write = _writer(asked)
    root = Path(asked.folder).expanduser() / asked.format
    splits = splits_of(job)
    whole = []
    for split in splits:  # Check all of them before writing the first.
        own = Ownership(Sums.read(root / split.id, overwrite=overwrite))
        whole.append(own.is_whole(split.key, ("*",), overwrite, INSTEAD))
    for split, is_there in zip(splits, whole, strict=True):
        state = "is there already" if is_there else _export(split, root / split.id, write, job)
        say(f"{root / split.id} {state}")


def _export(
    split: Split, target: Path, write: Callable[[Split, Path], None], job: Job[ExportStageOptions]
) -> str:
    """Export a split to a folder, unless it is there already, and return what the folder has."""
    overwrite = job.options.overwrite
    try:
        with produced(target, split.key, overwrite=overwrite, instead=INSTEAD) as made:
            if made is not None:
                write(split, made)
                File(made / ExportOptions.RECORD).write_text(
                    json.dumps(split.record(), indent=2) + "\n"
                )
                job.write_config(made)
    except DatasetError:
        raise
    except (OSError, RuntimeError) as error:  # h5py raises either.
        reason = getattr(error, "strerror", None) or one_line(error)
        if "unable to lock file" in reason:  # By HDF5, as on some network drives.
            reason += "; without locks: set HDF5_USE_FILE_LOCKING=FALSE in the environment"
        raise DatasetError(f"{target} cannot be written: {reason}") from error
    return "is there already" if made is None else f"has {split.count:,} episodes"


def _writer(asked: ExportOptions) -> Callable[[Split, Path], None]:
    """Return the function that writes a split into an empty folder, in a format."""
    module = import_module(asked.module)
    missing = [name for name in getattr(module, "NEEDS", ()) if find_spec(name) is None]
    check(
        not missing,
        f"export.format={asked.format} needs {' and '.join(missing)}: "
        f"pip install 'labyrinth-datasets[{asked.format}]'",
    )
    write: Callable[[Split, Path], None] = module.write
    return write


def splits_of(job: Job[ExportStageOptions]) -> list[Split]:
    """Return the splits to export; raises the same errors as `run`."""
    asked = job.options.export
    data = job.open_dataset()
    names = data.splits
    asked.check_splits(names)
    values, _ = front_matter.read(data.locate([Manifest.TABLE, f"../{README}"]).parent / README)
    return [
        Split(
            data,
            name,
            image_size=asked.image_size,
            licence=front_matter.licence_of(values),
        )
        for name in names
        if not asked.splits or name in asked.splits
    ]
