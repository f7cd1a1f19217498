"""One split of a dataset to export: its episodes, and the metadata that all formats use."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import SPLITS, Dataset, LoadedEpisode, Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.version import DEVELOPERS, __version__
from labyrinth_core.world import RULES
from pipeline.config import ExportOptions
from pipeline.machinery import tracked

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
        steps = ((len(episode) + 1, episode) for episode in found)
        number = 0
        for episode in tracked(steps, self.name, self.rows):
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
