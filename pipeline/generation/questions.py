"""The stage `questions`: write a config beside a dataset, with a question about each labyrinth.

The questions are made from the rows of the dataset, which do not change. Their folder has its own
manifest, in the format of a dataset's. Each shard is made from the dataset's shard of the same
name, and has its fingerprint, which shows whether the questions match the rows of the dataset.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import chain, islice, zip_longest
from typing import Any

from labyrinth_core.data.errors import DatasetError, one_line, readable
from labyrinth_core.data.manifest import MANIFEST, Manifest, Shard
from labyrinth_core.data.rows import check_file, check_footer
from labyrinth_core.data.storage import AnyPath, file_sha256, local_copy
from labyrinth_core.evaluation.questions import (
    QUESTION_COLUMNS,
    question,
    questions_config,
)
from pipeline.config.run import Run
from pipeline.generation.table import arrow_schema
from pipeline.inspection import front_matter
from pipeline.inspection.counts import routes_of
from pipeline.machinery.artifact import produced
from pipeline.machinery.console import say, tracked
from pipeline.machinery.dataset import build_versions
from pipeline.machinery.executor import ordered_map
from pipeline.machinery.folders import held, new_file

GROUP_ROWS = 256
"""The rows of a row group, about 3 MB."""
WRITER_OPTIONS = {
    "compression": "zstd",
    "use_dictionary": False,
    "write_statistics": ["labyrinth_id", "moves"],  # Those of pictures would be pictures.
    "write_page_index": True,
    "store_schema": False,
}
PICTURES = ("image", "image_300", "image_url")
"""The columns whose bytes depend on the version of zlib."""


def run(run: Run) -> None:
    """Write the questions about the dataset of a run, unless they are there already.

    Raises:
        DatasetError: The dataset does not exist or is damaged, its labyrinths allow no questions,
            or a user's files are in the place of the questions.
        OSError: The folder cannot be written.
    """
    manifest, folder = Manifest.read(run.folder), run.data_dir / questions_config(run.dataset.name)
    key = {"dataset": manifest.config.name, "fingerprint": manifest.fingerprint}
    found = front_matter.questions_of(run.data_dir, manifest)
    is_other = found is None or found.config != manifest.config  # Then replace it.
    overwrite = is_other or run.options.overwrite
    about = front_matter.shards_asked_about(manifest, manifest.config)
    names = [MANIFEST, *(shard.path for shard in about)]
    rules: dict[str, Any] = {"mark": MANIFEST, "names": names, "instead": "choose another data_dir"}
    with produced(folder, key, overwrite=overwrite, **rules) as made:
        state = "is there already" if made is None else _make(run, manifest, made)
    with held(run.data_dir, "README.md"):
        front_matter.update(run.data_dir)
    say(f"{folder} {state}.")


def _make(run: Run, manifest: Manifest, folder: AnyPath) -> str:
    """Write the questions about a dataset to a folder; return a phrase with their number."""
    about = front_matter.shards_asked_about(manifest, manifest.config)
    write = partial(_write, run.folder, folder)
    made = ((shard.rows, shard) for shard in ordered_map(write, about, run.options.workers))
    total = sum(shard.labyrinths for shard in about)
    shards = tuple(tracked(made, "questions", total=total))
    Manifest(manifest.config, build_versions(), shards, format=manifest.format).write(folder)
    return f"has {sum(shard.rows for shard in shards):,} questions"


def _write(dataset: AnyPath, folder: AnyPath, about: Shard) -> Shard:
    """Write the questions about a shard of a dataset, and return their shard."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = longest = 0
    schema = arrow_schema(QUESTION_COLUMNS)
    with new_file(folder / about.path, folder.parent) as path:
        with pq.ParquetWriter(path, schema, **WRITER_OPTIONS) as writer:
            writer.add_key_value_metadata(schema.metadata)
            questions = _questions(dataset, about)
            while group := list(islice(questions, GROUP_ROWS)):
                writer.write_table(pa.Table.from_pylist(group, schema))
                rows += len(group)
                longest = max(longest, *(row["moves"] for row in group))
        return Shard(
            path=about.path,
            split=about.split,
            labyrinths=rows,
            episodes=rows,
            rows=rows,
            longest=longest,
            cut=0,
            bytes=path.stat().st_size,
            sha256=file_sha256(path),
            fingerprint=about.fingerprint,
        )


def _questions(dataset: AnyPath, about: Shard) -> Iterator[dict[str, Any]]:
    """Yield the question about each labyrinth of a shard; raise DatasetError if one allows none."""
    for route in routes_of(dataset, about):
        if route.is_first:
            try:
                yield question(route.labyrinth)
            except ValueError as error:
                raise DatasetError(f"{dataset / about.path}: {error}") from error


def question_problems(data_dir: AnyPath, manifest: Manifest, workers: int = 1) -> list[str]:
    """Return what is wrong with the questions about a dataset, one line for each problem.

    Args:
        data_dir: The folder with the dataset and its questions.
        manifest: The manifest of the dataset.
        workers: The number of processes.
    """
    questions = front_matter.questions_of(data_dir, manifest)
    if questions is None:
        return []
    name = manifest.config.name
    about = front_matter.shards_asked_about(manifest, questions.config)
    pairs = list(zip(about, questions.shards, strict=True))
    same_bytes = dict(questions.versions) == build_versions()
    check = partial(_check, data_dir / name, data_dir / questions_config(name), same_bytes)
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
        with readable(path), local_copy(path) as local:
            check_file(local, shard, path)
            with pq.ParquetFile(local) as file:
                schema = arrow_schema(QUESTION_COLUMNS)
                if not file.schema_arrow.equals(schema, check_metadata=False):
                    return [f"{path}: its columns are not those of questions"]
                check_footer(file, shard, path)
                batches = map(pa.RecordBatch.to_pylist, file.iter_batches(GROUP_ROWS))
                pairs = zip_longest(chain.from_iterable(batches), _questions(dataset, about))
                for number, (row, right) in enumerate(pairs):
                    if row is None or right is None:
                        return [f"{path}: it has too few or too many rows, from row {number} on"]
                    for name in right:
                        if row[name] != right[name] and (same_bytes or name not in PICTURES):
                            wrong.setdefault(name, number)
    except DatasetError as error:
        return [one_line(error)]
    return [f"{path} row {row} {name}: not what the labyrinth gives" for name, row in wrong.items()]
