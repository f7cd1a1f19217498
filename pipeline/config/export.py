"""The options of exports, which the stages `export` and `publish` use, and where exports lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from labyrinth_core.data import SPLITS
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE, PICTURE_SIZE
from pipeline.config.errors import check, listed
from pipeline.config.option import check_options, option

EXPORTS = {
    "minari": "pipeline.export.minari",
    "imitation": "pipeline.export.imitation",
    "lerobot": "pipeline.export.lerobot",
}
"""Format -> the module whose `write` exports a split."""


@dataclass(frozen=True)
class ExportOptions:
    """The format and the folder of an export for another library."""

    format: str = option("", "library to export for: " + ", ".join(EXPORTS), one_of=EXPORTS)
    folder: str = option(
        "exports", "folder of the exports, with a subfolder for each format", is_local_folder=True
    )
    splits: tuple[str, ...] = option((), "splits to export, one or a list (all)", one_of=SPLITS)
    image_size: int = option(
        DEFAULT_IMAGE_SIZE, "pixels on each side of the pictures", at_least=1, at_most=PICTURE_SIZE
    )

    RELEASED: ClassVar = ("lerobot", "minari")
    """The formats whose libraries read the Hub, so that `publish.export` releases them."""
    NAMESPACE: ClassVar = "labyrinth"
    VERSION: ClassVar = 0
    """The first and the last part of every export's name; they never change."""
    RECORD: ClassVar = "labyrinth.json"
    """The file in each export's folder that says what the export was made from."""
    CODEBASE_VERSION: ClassVar = "v3.0"
    """The version of LeRobot's format, which is also the tag on the Hub that LeRobot reads."""

    @property
    def module(self) -> str:
        """The module whose `write` exports a split in the format."""
        return EXPORTS[self.format]

    def path(self, config: str) -> Path:
        """Return the folder of the exports of a dataset's config, with a subfolder a split."""
        return Path(self.folder).expanduser() / self.format / self.NAMESPACE / config

    def check(self) -> None:
        """Raise a ConfigError if an option is invalid."""
        check_options(self, ExportOptions, "export.")

    def check_splits(self, known: Sequence[str]) -> None:
        """Raise a ConfigError if a split is not among those of the dataset."""
        check(
            {*self.splits} <= {*known},
            f"export.splits={listed(self.splits)}: choose from {listed(known)}",
        )
