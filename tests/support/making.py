"""How the tests make runs and small datasets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pipeline.config.dataset import BucketsConfig
from pipeline.config.run import Run, RunConfig, resolve
from pipeline.generation import build


def run_of(data_dir: Path, **options: Any) -> Run:
    """Return the run with the options of `RunConfig`; a small one where they say nothing."""
    if "buckets" in options:
        options["buckets"] = BucketsConfig(*options["buckets"])
    small = {"stages": ["build"], "size": "3", "labyrinths": 8, "data_dir": str(data_dir)}
    return resolve(RunConfig(**small | options))


def build_dataset(
    data_dir: Path,
    *,
    cells_per_shard: int = build.CELLS_PER_SHARD,
    cells_per_chunk: tuple[int, int] = build.CELLS_PER_CHUNK,
    **options: Any,
) -> Run:
    """Build the dataset of `run_of`, and return the run."""
    run = run_of(data_dir, **options)
    build.run(run, cells_per_shard=cells_per_shard, cells_per_chunk=cells_per_chunk)
    return run


def make(data_dir: Path, size: str, task: str = "navigation", **options: Any) -> Path:
    """Build a dataset and return its folder."""
    return build_dataset(data_dir, size=size, task=task, **options).folder


def make_both(data_dir: Path) -> Path:
    """Build two datasets, write their card, and return the folder of both."""
    from pipeline.release import card  # It imports the Hub's client, which reads the environment.

    make(data_dir, "3x3", labyrinths=7, random_steps=25)
    make(data_dir, "3x4", "key_and_door", labyrinths=3, random_steps=25, solutions="all")
    card.write_card(data_dir)
    return data_dir
