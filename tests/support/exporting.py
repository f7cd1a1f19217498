"""How the exports of these tests are made, and what they have to hold."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from labyrinth_core import load_episodes
from labyrinth_core.data import LoadedEpisode
from pipeline.config import ExportOptions
from pipeline.export import stage
from support.making import Run, RunConfig, resolve

SIZE = 40
"""Pixels on each side of the pictures that are exported."""


def export(of: Run, folder: Path, format_: str, *splits: str, **options: Any) -> Path:
    """Export splits of a dataset, all if none is named, and return the folder of the exports."""
    stage.run(_run(of, folder, format_, splits, options))
    return folder / format_ / "labyrinth" / of.dataset.name


def split_of(of: Run, name: str) -> stage.Split:
    """Return a split of a dataset as formats are given it."""
    (split,) = stage.splits_of(_run(of, Path(), "lerobot", (name,), {}))
    return split


def _run(
    of: Run, folder: Path, format_: str, splits: tuple[str, ...], options: dict[str, Any]
) -> Run:
    asked = ExportOptions(format_, str(folder), splits, options.pop("image_size", SIZE))
    given = {"size": of.options.size, "task": of.options.task, "data_dir": of.options.data_dir}
    return resolve(RunConfig(stages=("export",), export=asked, **given | options))


def episodes(of: Run, split: str) -> Iterator[LoadedEpisode]:
    """Return the episodes that an export has to hold."""
    return load_episodes(of.data_dir, of.dataset.name, split=split, image_size=SIZE)
