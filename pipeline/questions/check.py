"""Make the questions about a dataset's labyrinths, and check a file of questions against them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import zip_longest
from typing import Any

from labyrinth_core.data import Dataset, ShardFile
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.questions import QUESTION_COLUMNS, question
from pipeline.inspection import routes_of
from pipeline.machinery import ordered_map

GROUP_ROWS = 256
"""The rows of a row group, about 3 MB."""
PICTURES = ("image", "image_300", "image_url")
"""The columns whose bytes depend on the version of zlib."""


def questions_of(about: ShardFile) -> Iterator[dict[str, Any]]:
    """Yield the question about each labyrinth of a shard; raise DatasetError if one allows none."""
    for route in routes_of(about):
        if route.is_first:
            try:
                yield question(route.labyrinth)
            except ValueError as error:
                raise DatasetError(f"{about.path}: {error}") from error


def question_problems(dataset: Dataset, made: Dataset, workers: int = 1) -> list[str]:
    """Return what is wrong with the questions about a dataset, one line for each problem.

    Args:
        dataset: The dataset.
        made: The questions.
        workers: The number of processes.
    """
    about = {file.shard.path: file for file in dataset.files()}
    pairs = [(about[file.shard.path], file) for file in made.files()]
    check = partial(_check, made.manifest.is_of_current_versions)
    return [line for lines in ordered_map(check, pairs, workers) for line in lines]


def _check(same_bytes: bool, made: tuple[ShardFile, ShardFile]) -> list[str]:
    """Return a message for each column of the questions that differs from what labyrinths give.

    Each column is named once, with the first row in which it is wrong.

    Args:
        same_bytes: Whether pictures must be equal byte for byte.
        made: A shard of the dataset, and the shard of the questions about it.
    """
    about, file = made
    path = file.path
    wrong: dict[str, int] = {}
    try:
        rows = file.records(QUESTION_COLUMNS, GROUP_ROWS)
        for number, (row, right) in enumerate(zip_longest(rows, questions_of(about))):
            if row is None or right is None:
                return [f"{path}: it has too few or too many rows, from row {number} on"]
            for name in right:
                if row[name] != right[name] and (same_bytes or name not in PICTURES):
                    wrong.setdefault(name, number)
    except DatasetError as error:
        return [one_line(error)]
    return [f"{path} row {row} {name}: not what the labyrinth gives" for name, row in wrong.items()]
