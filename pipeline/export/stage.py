"""The stage `export`: write splits of a dataset in the format of another library."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import SPLITS, Dataset, LoadedEpisode, Manifest
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.storage import File
from labyrinth_core.version import DEVELOPERS, __version__
from labyrinth_core.world import RULES
from pipeline.config import ExportOptions, Job, check
from pipeline.export.options import ExportStageOptions
from pipeline.inspection import front_matter
from pipeline.machinery import Ownership, Sums, produced, say, tracked

README = "README.md"
"""The card of the datasets in a folder, which may name their licence."""
INSTEAD = "choose another export.folder"

PART_BYTES = 16 << 20
"""The minimum bytes of pictures in a part; only the last part may have fewer."""

Item = TypeVar("Item")


@dataclass(frozen=True)
class Split:
    """One split of a dataset to export."""

    data: Dataset
    name: str
    """Such as `train`."""
    image_size: int
    """Pixels on each side of the pictures."""
    licence: str

    @property
    def manifest(self) -> Manifest:
        """The manifest of the dataset."""
        return self.data.manifest

    @property
    def id(self) -> str:
        """The name of the export, such as `labyrinth/5x5/train-v0`."""
        version = f"{self.name}-v{ExportOptions.VERSION}"
        return f"{ExportOptions.NAMESPACE}/{self.manifest.config.name}/{version}"

    @property
    def rows(self) -> int:
        """The number of states in its episodes."""
        return sum(shard.rows for shard in self.manifest.of(self.name))

    @property
    def count(self) -> int:
        """The number of its episodes."""
        return sum(shard.episodes for shard in self.manifest.of(self.name))

    @property
    def step_limit(self) -> int:
        """The number of steps after which an environment truncates an episode."""
        return RULES.step_limit * self.manifest.config.height * self.manifest.config.width

    @property
    def description(self) -> str:
        """A sentence that describes the split."""
        config = self.manifest.config
        return (
            f"Grid labyrinths of {config.height} x {config.width} cells, task {config.task}; "
            f"split {self.name}: {SPLITS[self.name].meaning}."
        )

    @property
    def demonstrator(self) -> str:
        """The policy that acts in its episodes."""
        config = self.manifest.config
        if self.name == "random":
            return "a uniformly random policy"
        if config.noise:
            return f"a shortest route, erring with probability {config.noise}"
        if config.solutions == "shortest":
            return "a shortest route"
        kind = "simple" if config.solutions == "all" else "shortest"
        every = f"every {kind} route"
        if any(shard.cut for shard in self.manifest.of(self.name)):
            every += f", at most {config.solutions_limit:,} per labyrinth"
        return every

    def record(self) -> dict[str, Any]:
        """Return the origin of the export in plain types; equal records mean equal exports."""
        return {
            "id": self.id,
            "description": self.description,
            "fingerprint": self.manifest.fingerprint,
            "config": self.manifest.config.to_json(),
            "split": self.name,
            "episodes": self.count,
            "rows": self.rows,
            "image_size": self.image_size,
            "authors": [DEVELOPERS],
            "licence": self.licence,
            "exported_by": f"labyrinth-datasets {__version__}",
        }

    @property
    def key(self) -> dict[str, Any]:
        """The record, with the options of the dataset at its top level."""
        record = self.record()
        return {**record.pop("config"), **record}

    def episodes(self) -> Iterator[LoadedEpisode]:
        """Yield the episodes in order, with a progress bar.

        Raises:
            DatasetError: They cannot be read, their number differs from the manifest, or the
                dataset was replaced after its manifest was read.
        """
        found = self.data[self.name].iterate_episodes(image_size=self.image_size)
        self.data.require_unchanged()
        number = 0
        for episode in tracked(found, self.name, self.rows, lambda each: len(each) + 1):
            number += 1
            yield episode
        if number != self.count:
            raise DatasetError(
                f"split={self.name}: {number} episodes, but the manifest says {self.count}"
            )


def in_parts(items: Iterable[tuple[int, Item]], part_bytes: int) -> Iterator[list[Item]]:
    """Group consecutive items, given with their sizes, into lists of at least `part_bytes`."""
    part: list[Item] = []
    held = 0
    for size, item in items:
        part.append(item)
        held += size
        if held >= part_bytes:
            yield part
            part, held = [], 0
    if part:
        yield part


def png_value(picture: NDArray[np.uint8]) -> dict[str, Any]:
    """Return a picture, shape (height, width, 3), in the form that `datasets` uses: a PNG file."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(picture).save(file, "PNG")
    return {"bytes": file.getvalue(), "path": None}


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
