"""Make the questions about a dataset's labyrinths, and check a file of questions against them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from itertools import chain, zip_longest
from typing import Any

from labyrinth_core.data.errors import DatasetError, one_line, readable
from labyrinth_core.data.format import arrow_schema
from labyrinth_core.data.manifest import Manifest, Shard
from labyrinth_core.data.rows import check_file, check_footer, each_read
from labyrinth_core.data.storage import AnyPath, local_copy
from labyrinth_core.evaluation.questions import QUESTION_COLUMNS, question
from pipeline.inspection.counts import routes_of
from pipeline.machinery.dataset import build_versions
from pipeline.machinery.executor import ordered_map

GROUP_ROWS = 256
"""The rows of a row group, about 3 MB."""
PICTURES = ("image", "image_300", "image_url")
"""The columns whose bytes depend on the version of zlib."""


def questions_of(dataset: AnyPath, about: Shard) -> Iterator[dict[str, Any]]:
    """Yield the question about each labyrinth of a shard; raise DatasetError if one allows none."""
    for route in routes_of(dataset, about):
        if route.is_first:
            try:
                yield question(route.labyrinth)
            except ValueError as error:
                raise DatasetError(f"{dataset / about.path}: {error}") from error


def question_problems(
    dataset: AnyPath, manifest: Manifest, folder: AnyPath, made: Manifest, workers: int = 1
) -> list[str]:
    """Return what is wrong with the questions about a dataset, one line for each problem.

    Args:
        dataset: The folder of the dataset.
        manifest: The manifest of the dataset.
        folder: The folder of the questions.
        made: The manifest of the questions.
        workers: The number of processes.
    """
    about = {shard.path: shard for shard in manifest.shards}
    pairs = [(about[shard.path], shard) for shard in made.shards]
    check = partial(_check, dataset, folder, dict(made.versions) == build_versions())
    return [line for lines in ordered_map(check, pairs, workers) for line in lines]


def _check(
    dataset: AnyPath, folder: AnyPath, same_bytes: bool, made: tuple[Shard, Shard]
) -> list[str]:
    """Return a message for each column of the questions that differs from what labyrinths give.

    Each column is named once, with the first row in which it is wrong.

    Args:
        dataset: The folder of the dataset.
        folder: The folder of the questions.
        same_bytes: Whether pictures must be equal byte for byte.
        made: A shard of the dataset, and the shard of the questions about it.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    about, shard = made
    path = folder / shard.path
    wrong: dict[str, int] = {}
    try:
        with ExitStack() as stack:
            with readable(path):
                local = stack.enter_context(local_copy(path))
            check_file(local, shard, path)
            with readable(path):
                file = stack.enter_context(pq.ParquetFile(local))
            schema = arrow_schema(QUESTION_COLUMNS)
            if not file.schema_arrow.equals(schema, check_metadata=False):
                return [f"{path}: its columns are not those of questions"]
            check_footer(file, shard, path)
            # Converted as they are read, since a text may not be UTF-8.
            batches = map(pa.RecordBatch.to_pylist, file.iter_batches(GROUP_ROWS))
            rows = chain.from_iterable(each_read(batches, path))
            for number, (row, right) in enumerate(zip_longest(rows, questions_of(dataset, about))):
                if row is None or right is None:
                    return [f"{path}: it has too few or too many rows, from row {number} on"]
                for name in right:
                    if row[name] != right[name] and (same_bytes or name not in PICTURES):
                        wrong.setdefault(name, number)
    except DatasetError as error:
        return [one_line(error)]
    return [f"{path} row {row} {name}: not what the labyrinth gives" for name, row in wrong.items()]
