"""The options of exports, which the stages `export` and `publish` use, and where exports lie."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from labyrinth_core.data.splits import SPLITS
from labyrinth_core.pictures.png import DEFAULT_IMAGE_SIZE, PICTURE_SIZE
from pipeline.config.option import LOCAL_FOLDER, option

EXPORTS = {
    "minari": "pipeline.export.minari",
    "imitation": "pipeline.export.imitation",
    "lerobot": "pipeline.export.lerobot",
}
"""Format -> the module whose `write` exports a split."""

RELEASED = ("lerobot", "minari")
"""The formats whose libraries read the Hub, so that `publish.export` releases them."""

NAMESPACE, VERSION = "labyrinth", 0
"""The first and the last part of every export's name; they never change."""

RECORD = "labyrinth.json"
"""The file in each export's folder that says what the export was made from."""

CODEBASE_VERSION = "v3.0"
"""The version of LeRobot's format, which is also the tag on the Hub that LeRobot reads."""


@dataclass(frozen=True)
class ExportOptions:
    """The format and the folder of an export for another library."""

    format: str = option("", "library to export for: " + ", ".join(EXPORTS), one_of=EXPORTS)
    folder: str = option(
        "exports", "folder of the exports, with a subfolder for each format", like=LOCAL_FOLDER
    )
    splits: tuple[str, ...] = option((), "splits to export, one or a list (all)", one_of=SPLITS)
    image_size: int = option(
        DEFAULT_IMAGE_SIZE, "pixels on each side of the pictures", at_least=1, at_most=PICTURE_SIZE
    )

    @property
    def module(self) -> str:
        """The module whose `write` exports a split in the format."""
        return EXPORTS[self.format]

    def path(self, config: str) -> Path:
        """Return the folder of the exports of a dataset's config, with a subfolder a split."""
        return Path(self.folder).expanduser() / self.format / NAMESPACE / config
