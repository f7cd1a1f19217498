"""Shards as they are opened."""

from __future__ import annotations

import gc
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.making import Run

from labyrinth_core import load_episodes
from labyrinth_core.data import COLUMNS
from pipeline.generation.table import read_schema


@pytest.mark.slow
def test_a_closed_shard_is_out_of_memory_at_once(small_dataset: Run) -> None:
    # Its metadata have megabytes, and the collector of cycles may not come for a hundred shards.
    path = next(Path(small_dataset.local_dir).glob("*/train-*.parquet"))
    gc.collect()
    gc.disable()
    before = _metadata_in_memory()
    try:
        with COLUMNS.opened(path) as file:
            file.read_row_group(0)
        assert read_schema(path).equals(COLUMNS.arrow_schema())
        del file
        assert _metadata_in_memory() == before
    finally:
        gc.enable()


def _metadata_in_memory() -> int:
    # Not by isinstance, which some libraries' objects answer with a warning.
    return sum(type(each) is pq.FileMetaData for each in gc.get_objects())


def test_a_reader_that_is_closed_where_python_ends_says_nothing(
    small_dataset: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = load_episodes(small_dataset.data_dir, small_dataset.folder.name)
    next(rows)
    monkeypatch.setattr(pa, "ArrowException", None)  # As Python leaves it then.
    rows.close()
