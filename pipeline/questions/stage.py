"""The stage `questions`: write a config beside a dataset, with a question about each labyrinth.

The questions are made from the rows of the dataset, which do not change. Their folder has its own
manifest, in the format of a dataset's. Each shard is made from the dataset's shard of the same
name, and has its fingerprint, which shows whether the questions match the rows of the dataset.
"""

from __future__ import annotations

from functools import partial
from itertools import islice
from typing import Any

from labyrinth_core.data import Dataset, Manifest, Shard, ShardFile
from labyrinth_core.questions import QUESTION_COLUMNS
from labyrinth_core.storage import AnyPath, File
from pipeline.config import Job, WorkOptions
from pipeline.inspection import front_matter
from pipeline.machinery import held, ordered_map, produced, say, tracked
from pipeline.questions.companion import COMPANION, GROUP_ROWS, questions_of

WRITER_OPTIONS = {
    "compression": "zstd",
    "use_dictionary": False,
    "write_statistics": ["labyrinth_id", "moves"],  # Those of pictures would be pictures.
    "write_page_index": True,
    "store_schema": False,
}


def run(job: Job[WorkOptions]) -> None:
    """Write the questions about the dataset of a run, unless they are there already.

    Raises:
        DatasetError: The dataset does not exist or is damaged, its labyrinths allow no questions,
            or a user's files are in the place of the questions.
        OSError: The folder cannot be written.
    """
    data, folder = Dataset.at(job.folder), job.data_dir / COMPANION.config(job.dataset.name)
    manifest = data.manifest
    key = {"dataset": manifest.config.name, "fingerprint": manifest.fingerprint}
    found = COMPANION.of(job.data_dir, manifest)
    is_other = found is None or found.manifest.config != manifest.config  # Then replace it.
    overwrite = is_other or job.options.overwrite
    about = COMPANION.shards(manifest, manifest.config)
    names = [Manifest.FILE, *(shard.path for shard in about)]
    rules: dict[str, Any] = {
        "mark": Manifest.FILE,
        "names": names,
        "instead": "choose another data_dir",
    }
    with produced(folder, key, overwrite=overwrite, **rules) as made:
        state = "is there already" if made is None else _make(data, made, job.options.workers)
    with held(job.data_dir, "README.md"):
        front_matter.update(job.data_dir)
    say(f"{folder} {state}.")


def _make(data: Dataset, folder: AnyPath, workers: int) -> str:
    """Write the questions about a dataset to a folder; return a phrase with their number."""
    manifest = data.manifest
    needed = COMPANION.shards(manifest, manifest.config)
    files = {file.shard.path: file for file in data.files()}
    about = [files[shard.path] for shard in needed]
    made = ordered_map(partial(_write, folder), about, workers)
    total = sum(shard.labyrinths for shard in needed)
    shards = tuple(tracked(made, "questions", total, lambda shard: shard.rows))
    Manifest(manifest.config, Manifest.current_versions(), shards, format=manifest.format).write(
        folder
    )
    return f"has {sum(shard.rows for shard in shards):,} questions"


def _write(folder: AnyPath, file: ShardFile) -> Shard:
    """Write the questions about a shard of a dataset, and return their shard."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows, longest, about = 0, 0, file.shard
    schema = QUESTION_COLUMNS.arrow_schema()
    with File(folder / about.path).replacing(folder.parent) as path:
        with pq.ParquetWriter(path, schema, **WRITER_OPTIONS) as writer:
            writer.add_key_value_metadata(schema.metadata)
            questions = questions_of(file)
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
            sha256=File(path).sha256(),
            fingerprint=about.fingerprint,
        )
