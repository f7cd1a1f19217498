"""Making questions about a dataset's labyrinths, checking a file of them, and their declaration.

The declaration is what card, release and validation must know of the questions beside a dataset.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import deepcopy
from functools import partial
from importlib.resources import files
from itertools import zip_longest
from string import Template
from typing import Any

import yaml

from labyrinth_core.data import Dataset, DatasetConfig, Manifest, ShardFile
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.questions import QUESTION_COLUMNS, question
from pipeline.inspection import Companion, routes_of
from pipeline.machinery import ordered_map, table

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


NOT_ASKED = ("train", "validation", "random")
"""The splits for training and model selection, which have no questions."""
EVAL = "eval.yaml"
"""The file that registers the questions as a benchmark of inspect-ai."""


def section(questions: Mapping[str, Manifest], name: str, version: str | None) -> str:
    """Return the card's section on the questions; see `Companion.section`."""
    return Template(_read("card.md")).substitute(
        names=", ".join(f"`{config}`" for config in questions),
        columns=table(
            ("column", "meaning"), ((f"`{c.name}`", c.meaning) for c in QUESTION_COLUMNS), "ll"
        ),
        name=name,
        revision=f', revision="{version}"' if version else "",
        shown=next(iter(questions)),
    )


def benchmark(questions: Mapping[str, Manifest], title: str) -> dict[str, bytes]:
    """Return the eval.yaml of a folder of datasets.

    The form is from https://huggingface.co/docs/hub/eval-results, "Registering a Benchmark":
    inspect-ai runs one task per split with questions as text, and one with pictures.

    Args:
        questions: The manifests of the questions, by config.
        title: The name of the benchmark.
    """
    values = yaml.safe_load(_read(EVAL))
    each, forms = values.pop("each"), values["tasks"]
    values["tasks"] = [
        {"id": f"{config}{form}-{split}", "config": config, "split": split}
        # A copy, or the file would refer to the first task in all others.
        | deepcopy(own | each)
        for config, manifest in questions.items()
        for form, own in forms.items()
        for split in _asked(manifest.config)
    ]
    text = yaml.safe_dump({"name": title} | values, sort_keys=False, allow_unicode=True, width=100)
    return {EVAL: text.encode()}


def _asked(config: DatasetConfig) -> tuple[str, ...]:
    """Return the splits whose labyrinths become questions."""
    return tuple(split for split in config.splits if split not in NOT_ASKED)


def _read(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


COMPANION = Companion(
    suffix="questions",
    columns=QUESTION_COLUMNS,
    splits=_asked,
    row="labyrinth, as a question",
    problems=question_problems,
    section=section,
    files=benchmark,
    file_names=(EVAL,),
)
