"""Files of strangers that claim more than they hold: the memory that reading them takes.

Each is read in a process that may not take more memory than the limit. These processes are forked
from one that has imported the libraries.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.making import Run

from labyrinth_core import DatasetError, load_transitions
from labyrinth_core.data import COLUMNS, TABLE_COLUMNS, Manifest
from labyrinth_core.data.dataset import Part
from labyrinth_core.storage import File

MOST = 700 << 20
"""Bytes of memory beyond those of the libraries."""

PROGRAM = """
import os, pathlib, resource, sys
import numpy, pyarrow, pyarrow.acero, pyarrow.compute as pc, pyarrow.dataset, pyarrow.parquet
import labyrinth_core
from labyrinth_core import (
    Dataset, load_arrays, load_episodes, load_transitions, stream_episodes, stream_transitions
)
from labyrinth_core.errors import DatasetError
from pipeline.generation.check import validate
from pipeline.generation.table import structures_in
from labyrinth_core.data import Manifest

pyarrow.set_cpu_count(1)  # Each thread reserves addresses that it does not use.
moves = pc.field("moves") > 0
task = pc.field("task") == "navigation"
vector = {"observation": "vector"}
WAYS = {
    "pictures": lambda: load_transitions(where, "3x3", cache_dir=False),
    "vectors": lambda: load_transitions(where, "3x3", **vector),
    "some": lambda: load_transitions(where, "3x3", cache_dir=False, labyrinths=1),
    "where": lambda: load_transitions(where, "3x3", cache_dir=False, where=moves & task),
    "episodes": lambda: sum(1 for _ in load_episodes(where, "3x3")),
    "stream": lambda: sum(1 for _ in stream_transitions(where, "3x3")),
    "shuffled": lambda: sum(1 for _ in stream_episodes(where, "3x3", shuffle=True, **vector)),
    "some of a stream": lambda: sum(1 for _ in stream_transitions(where, "3x3", where=moves)),
    "arrays": lambda: load_arrays(where, "3x3", "train"),
    "validate": lambda: print(validate(Dataset.at(path))),
    "structures": lambda: structures_in(Dataset.at(path)),
}
def read(most):
    status = open("/proc/self/status").read()
    held = int(status.partition("VmSize:")[2].split()[0]) << 10
    resource.setrlimit(resource.RLIMIT_AS, (held + most,) * 2)
    for name, way in WAYS.items():
        try:
            way()
        except DatasetError as error:
            assert "\\n" not in str(error), error
            print(name, error)
        else:
            print(name, "is read")

for line in sys.stdin:
    where = line.strip()
    path = pathlib.Path(where, "3x3")
    if (child := os.fork()) == 0:
        read(int(sys.argv[1]))
        break
    print("status", os.waitpid(child, 0)[1], flush=True)
"""

Outcome = Callable[[Path], list[str]]


@pytest.fixture(scope="module")
def outcome() -> Iterator[Outcome]:
    """A function that returns what reading a dataset in every way prints, with little memory."""
    command = [sys.executable, "-c", PROGRAM, str(MOST)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as process:

        def printed(folder: Path) -> list[str]:
            process.stdin.write(f"{folder}\n")
            process.stdin.flush()
            lines = []
            while not (line := process.stdout.readline()).startswith("status "):
                assert line, "the process has ended"
                lines.append(line.strip())
            assert line == "status 0\n", line
            return lines

        yield printed
        process.stdin.close()


@pytest.fixture
def folder(small_dataset: Run, tmp_path: Path) -> Path:
    """A copy of a small dataset."""
    return Path(shutil.copytree(small_dataset.data_dir, tmp_path / "copy")) / "3x3"


def claim(folder: Path, **values: Any) -> None:
    """Make the manifest say other things of the shard of train."""
    content = json.loads((folder / Manifest.FILE).read_bytes())
    content["shards"][0] |= values
    (folder / Manifest.FILE).write_text(json.dumps(content))


def pad(path: Path, count: int) -> None:
    """Put bytes between the pages and the footer of a Parquet file."""
    raw = path.read_bytes()
    end = len(raw) - 8 - int.from_bytes(raw[-8:-4], "little")
    path.write_bytes(raw[:end] + bytes(count) + raw[end:])


def put_shard(folder: Path, columns: dict[str, Any], padding: int = 0, **options: Any) -> None:
    """Write the shard of train, and a manifest that agrees."""
    path = folder / "train-00000-of-00001.parquet"
    table = pa.table(columns)
    pq.write_table(table, path, compression="zstd", store_schema=False, **options)
    pad(path, padding)
    made = {"rows": len(table), "bytes": path.stat().st_size, "sha256": File(path).sha256()}
    claim(folder, **made)


def put_table(folder: Path, count: int, padding: int = 0, **columns: Any) -> None:
    """Write a table of `count` labyrinths of train, and a manifest that agrees as it can."""
    schema = TABLE_COLUMNS.arrow_schema()
    usual = {"split": "train", "task": "navigation", "first_row": 0}

    def column(field: pa.Field) -> pa.Array:
        value = usual.get(field.name, "0" * 16 if field.type == pa.string() else 1)
        return columns.get(field.name, pa.repeat(pa.scalar(value, field.type), count))

    path = folder / Manifest.TABLE
    table = pa.table({field.name: column(field) for field in schema})
    pq.write_table(table, path, compression="zstd", store_schema=False)
    pad(path, padding)
    manifest = Manifest.read(folder)
    train = [shard for shard in manifest.shards if shard.split == "train"]
    shards = tuple(replace(shard, labyrinths=count) for shard in train)
    replace(manifest, shards=shards).with_table(path).write(folder)


def rows(count: int, picture: bytes = b"", text: str = "") -> dict[str, Any]:
    """Return the columns of a shard whose rows all have one picture and one text, stored once."""
    first = np.zeros(count, np.int32)
    pictures = pa.DictionaryArray.from_arrays(first, pa.array([picture], pa.binary()))
    return {
        "obs": pa.StructArray.from_arrays(
            [pictures, pa.nulls(count, pa.string())], ["bytes", "path"]
        ),
        "actions": pa.array(first, pa.int64()),
        "rewards": pa.array(first, pa.float32()),
        "episode_starts": pa.repeat(False, count),
        "info": pa.DictionaryArray.from_arrays(first, pa.array([text], pa.string())),
    }


TRAIN = "train-00000-of-00001.parquet"
PICTURE = bytes(400_000)


def shares(count: int) -> dict[str, Any]:
    """Return columns whose pictures begin alike; each but the first is stored as that length."""
    pictures = pa.array([bytes(20_000)] * count, pa.binary())
    obs = pa.StructArray.from_arrays([pictures, pa.nulls(count, pa.string())], ["bytes", "path"])
    return rows(count) | {"obs": obs}


def long_text(name: str) -> Callable[[Path], None]:
    text = pa.DictionaryArray.from_arrays(np.zeros(4096, np.int32), pa.array(["x" * 900_000]))
    return lambda folder: put_table(folder, 4096, padding=4096, **{name: text})


FILES = {
    "a picture in many rows": (
        lambda folder: put_shard(folder, rows(4096, PICTURE), padding=4096),
        ("stream row 0 episode_starts: False", "vectors row 0 episode_starts: False"),
    ),
    "a text in many rows": (
        lambda folder: put_shard(folder, rows(4096, b"", "x" * 8_000_000), padding=4096),
        ("vectors row 0 episode_starts: False",),
    ),
    "long texts in many row groups": (
        lambda folder: put_shard(
            folder, rows(8_000, b"", "x" * 8_000_000), padding=8_000, row_group_size=100
        ),
        ("vectors row 0 episode_starts: False",),
    ),
    "a longer text than any": (
        lambda folder: put_shard(folder, rows(99, b"", "x" * 20_000_000)),
        (f"{TRAIN} is damaged: a row group has 20", "bytes of texts, more than 16777216"),
    ),
    "pictures that begin alike": (
        lambda folder: put_shard(
            folder,
            shares(9_000),
            padding=9_000,
            use_dictionary=False,
            column_encoding={"obs.bytes": "DELTA_BYTE_ARRAY"},
        ),
        (f"{TRAIN} cannot be read: Not yet implemented",),
    ),
    "more rows than bytes": (
        lambda folder: put_shard(folder, rows(40_000)),
        (f"manifest.json cannot be read: {TRAIN} has 40000 rows in ",),
    ),
    "3e9 rows": (
        lambda folder: claim(folder, rows=3 * 10**9),
        (f"{TRAIN} has 3000000000 rows in ",),
    ),
    "1e12 rows": (
        lambda folder: claim(folder, rows=10**12),
        (f"{TRAIN} has 1000000000000 rows in ",),
    ),
    "3e9 rows and bytes": (
        lambda folder: claim(folder, rows=3 * 10**9, bytes=3 * 10**9),
        (
            f"{TRAIN} is damaged: it has ",
            "pictures /",
        ),
    ),
    "1e12 rows and bytes": (
        lambda folder: claim(folder, rows=10**12, bytes=10**12),
        ("pictures /", f"{TRAIN} is damaged: it has "),
    ),
    "a table of more rows than bytes": (
        lambda folder: put_table(folder, 400_000),
        ("labyrinths.parquet is damaged: 400000 rows in ",),
    ),
    "a table of other rows than the manifest's": (
        lambda folder: (put_table(folder, 40_000), claim(folder, labyrinths=8)),
        ("labyrinths.parquet is damaged: 40000 rows, but the manifest has 8 labyrinths",),
    ),
    "a long text in a table": (
        long_text("task"),
        ("where labyrinths.parquet task: a text has more than 99 bytes",),
    ),
    "a long name of a split in a table": (
        long_text("split"),
        ("some labyrinths.parquet split: a text has more than 99 bytes",),
    ),
    "long ids in a table": (
        long_text("structure_id"),
        ("structures labyrinths.parquet structure_id: a text has more than 99 bytes",),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize(("make", "messages"), FILES.values(), ids=FILES)
def test_a_small_file_takes_little_memory(
    folder: Path, outcome: Outcome, make: Callable[[Path], object], messages: tuple[str, ...]
) -> None:
    make(folder)
    printed = "\n".join(outcome(folder.parent))
    for message in messages:
        assert message in printed


@pytest.mark.slow
def test_a_sound_dataset_is_read_within_the_same_limit(folder: Path, outcome: Outcome) -> None:
    lines = outcome(folder.parent)
    assert [line for line in lines if not line.endswith("is read")] == ["[]"]


def test_rows_that_a_footer_hides_are_counted(folder: Path) -> None:
    # Its number of rows is one field, and those of its row groups are others.
    path = folder / TRAIN
    with COLUMNS.opened(path) as file:
        footer = file.metadata
        counted = SimpleNamespace(num_rows=7, num_row_groups=1, row_group=footer.row_group)
        shard = Manifest.read(folder).of("train")[0]
        assert shard.footer_problem(file) is None
        message = f"rows {shard.rows}, but the manifest says {shard.rows + 1}"
        assert replace(shard, rows=shard.rows + 1).footer_problem(file) == message
        hidden: Any = SimpleNamespace(metadata=counted)
        assert replace(shard, rows=7).footer_problem(hidden) is not None


def test_pictures_that_no_memory_can_hold_are_refused_in_one_line(
    small_dataset: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Part, "__len__", lambda _: 10**12)
    message = r"\A1,000,000,000,000 pictures of 64 x 64 pixels take 12,288,000.0 GB, [^\n]+\Z"
    with pytest.raises(DatasetError, match=message):
        load_transitions(small_dataset.data_dir, "3x3", cache_dir=False)
