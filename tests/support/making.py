"""How the datasets of these tests are made."""

from __future__ import annotations

from pathlib import Path

from pipeline.config.run import RunConfig, resolve
from pipeline.generation import build
from pipeline.release import card


def make(
    data_dir: Path,
    size: str,
    task: str = "navigation",
    *,
    cells_per_shard: int = build.CELLS_PER_SHARD,
    **options: object,
) -> Path:
    """Build a dataset and return its folder."""
    config = RunConfig(stages=["build"], size=size, task=task, data_dir=str(data_dir), **options)
    run = resolve(config)
    build.run(run, cells_per_shard=cells_per_shard)
    return run.folder


def make_both(data_dir: Path) -> Path:
    """Build the two datasets of these tests, write their card, and return the folder of both."""
    make(data_dir, "3x3", labyrinths=7, random_steps=25)
    make(data_dir, "3x4", "key_and_door", labyrinths=3, random_steps=25, solutions="all")
    card.write_card(data_dir)
    return data_dir
