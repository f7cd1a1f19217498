"""Measure ways of writing rows to Parquet: bytes per row, and the time to write and read them.

    python scripts/benchmark_parquet.py
    python scripts/benchmark_parquet.py --quick

The rows are those of optimal episodes and of a random policy's, which return to states that they
have visited. The ways alternate in every round; figures are medians of CPU time. A reader reads a
file as `datasets` does without decoding, row group by row group, then 100 single row groups, as in
random access.
"""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from functools import partial
from statistics import median
from typing import Any, NamedTuple

import pyarrow.parquet as pq
from measuring import machine, parser_of, take_turns

from labyrinth_core.data.columns import Row
from pipeline.config.run import RunConfig, resolve
from pipeline.generation import write as writing
from pipeline.generation.candidates import unpack
from pipeline.generation.render import render
from pipeline.generation.sample import sample
from pipeline.generation.solve import solve
from pipeline.generation.variants import labyrinth_of

WAYS: dict[str, tuple[int, dict[str, Any]]] = {
    "as chosen": (writing.ROW_GROUP, {}),
    "zstd 3": (writing.ROW_GROUP, {"compression_level": 3}),
    "zstd 9": (writing.ROW_GROUP, {"compression_level": 9}),
    "zstd -1": (writing.ROW_GROUP, {"compression_level": -1}),
    "lz4": (writing.ROW_GROUP, {"compression": "lz4", "compression_level": None}),
    "snappy": (writing.ROW_GROUP, {"compression": "snappy", "compression_level": None}),
    "not compressed": (writing.ROW_GROUP, {"compression": "none", "compression_level": None}),
    "groups of 64": (64, {}),
    "groups of 1,024": (1_024, {}),
    "pages of 64 KiB": (writing.ROW_GROUP, {"data_page_size": 2**16}),
    "dictionary of pictures": (writing.ROW_GROUP, {"use_dictionary": ["info", "obs.bytes"]}),
    "no statistics": (writing.ROW_GROUP, {"write_statistics": False}),
    "no page index": (writing.ROW_GROUP, {"write_page_index": False}),
}
"""Way -> the number of rows in a group, and the differences from `WRITER_OPTIONS`."""


class Turn(NamedTuple):
    """The measurements of one way; times are CPU seconds per row."""

    bytes: float
    write: float
    read: float
    jump: float
    """The seconds to read one row group."""


def episodes_of(size: str, labyrinths: int, split: str) -> list[list[Row]]:
    """Return the rows of each episode of a split."""
    options = RunConfig(stages=["build"], size=size, labyrinths=labyrinths, data_dir="unused")
    config = resolve(options).dataset
    train = unpack(config, sample(config).structures["train"])
    labyrinths = (labyrinth_of(config, split, each) for each in train)
    solutions = enumerate(solve(config, split, labyrinths))
    return [rows for n, solution in solutions for rows in render(split, n, solution.episodes)]


def take_turn(episodes: list[list[Row]], row_group: int, options: dict[str, Any]) -> Turn:
    """Write and read the episodes once."""
    count = sum(map(len, episodes))
    file = io.BytesIO()
    begin = time.process_time()
    with pq.ParquetWriter(
        file, writing.written_schema(), **writing.WRITER_OPTIONS | options
    ) as writer:
        for table in tables(episodes, row_group):
            writer.write_table(table)
    written = time.process_time()
    reader = pq.ParquetFile(io.BytesIO(file.getvalue()))
    for group in range(reader.num_row_groups):
        reader.read_row_group(group, use_threads=False)
    read = time.process_time()
    for number in range(100):
        reader.read_row_group(number * 7 % reader.num_row_groups, use_threads=False)
    jumped = time.process_time()
    return Turn(
        bytes=len(file.getvalue()) / count,
        write=(written - begin) / count,
        read=(read - written) / count,
        jump=(jumped - read) / 100,
    )


def tables(episodes: list[list[Row]], row_group: int) -> Iterator[Any]:
    """Yield the row groups as tables, as `write` makes them."""
    group: list[Row] = []
    for rows in episodes:
        group += rows
        if len(group) >= row_group:
            yield writing.rows_table(group)
            group = []
    if group:
        yield writing.rows_table(group)


def main() -> None:
    """Measure and print."""
    arguments = parser_of(__doc__, rounds=7).parse_args()
    rounds, share = (2, 10) if arguments.quick else (arguments.rounds, 1)
    print(machine("numpy", "pyarrow"))
    print(f"us a row, CPU time, medians of {rounds} rounds; ms a group for a single row group")
    for size, labyrinths, split in [("5", 300, "train"), ("5", 50, "random"), ("25", 50, "train")]:
        episodes = episodes_of(size, max(1, labyrinths // share), split)
        ways = {name: partial(take_turn, episodes, *way) for name, way in WAYS.items()}
        turns = take_turns(ways, rounds)
        print(f"\nsize {size}, {split}: {sum(map(len, episodes)):,} rows")
        print(f"{'':>24}{'bytes a row':>12}{'write':>8}{'read':>8}{'one group':>11}")
        for way, of_way in turns.items():
            size_of_row, write, read, jump = map(median, zip(*of_way, strict=True))
            print(f"{way:>24}{size_of_row:12.1f}{1e6 * write:8.2f}{1e6 * read:8.2f}", end="")
            print(f"{1e3 * jump:8.2f} ms")


if __name__ == "__main__":
    main()
