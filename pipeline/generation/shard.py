"""Make one shard: solve its labyrinths, render them and write them, in batches.

A finished shard is not made again. So a stopped build resumes, parts are joined, and a dataset is
repaired or grows.
"""

from __future__ import annotations

import gc
import hashlib
import json
import shutil
import struct
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from itertools import islice, repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from labyrinth_core.data import COLUMNS, DatasetConfig, Manifest, Shard
from labyrinth_core.errors import DatasetError
from labyrinth_core.language import dump
from labyrinth_core.pictures import StatePictures
from labyrinth_core.storage import AnyPath, File
from labyrinth_core.world import Episode, Labyrinth
from pipeline.generation.labyrinths import Records, Solution, numbered_labyrinths, unpack
from pipeline.generation.table import (
    FACTS,
    Content,
    Facts,
    table_facts,
    text_array,
    value_array,
)

if TYPE_CHECKING:
    import pyarrow as pa

CELLS_PER_BATCH = 2_000
"""The cells of the labyrinths in a batch: 80 labyrinths at 5x5. Without batches a build would cost
8% to 15% more (600 labyrinths at 5x5, CPU time, 12 rounds)."""

DRAWN_AT_ONCE = 128
"""The number of rows of an episode that are drawn together; 20 MB of pictures at 250x250."""

WRITER_OPTIONS = {
    # docs/performance.md compares them with others.
    "compression": "zstd",
    "compression_level": 1,
    "use_dictionary": ["info"],
    # The statistics of a column of pictures would hold whole pictures.
    "write_statistics": [column.name for column in COLUMNS.numbers],
    "write_page_index": True,
    # With the schema, readers would get the texts as indices into a dictionary.
    "store_schema": False,
}


@dataclass(frozen=True)
class ShardThere:
    """A shard of the finished dataset that is being repaired or grows."""

    path: AnyPath
    shard: Shard
    table_row: int | None = None
    """The row of its first labyrinth in the table of labyrinths; None if the shard or the table is
    damaged, so that the shard is made again."""


@dataclass(frozen=True)
class ShardJob:
    """All that a worker needs to make one shard; equal jobs give equal bytes."""

    config: DatasetConfig
    split: str
    first: int
    """The index of its first labyrinth in the split."""
    structures: Records
    path: AnyPath
    building: AnyPath
    """The folder of the sidecar."""
    there: ShardThere | None = None
    """The shard of the same structures in the finished dataset, if it has one."""

    @property
    def sidecar(self) -> AnyPath:
        """The path of the shard's `Sidecar`."""
        return self.building / f"{self.path.name.removesuffix('.parquet')}.shard"

    @property
    def key(self) -> str:
        """A hash of everything that determines the bytes of the shard."""
        options = self.config.to_json()
        config = {name: options[name] for name in options.keys() - {"labyrinths", "shifts"}}
        of_all = sorted(config.items()), Manifest.current_versions()
        parts = of_all, self.split, self.first, self.structures.tobytes()
        return hashlib.sha256(repr(parts).encode()).hexdigest()


class Sidecar(NamedTuple):
    """What a worker leaves beside a shard that it has finished.

    The file is a line of JSON, and the bytes of the facts.
    """

    shard: Shard
    facts: Facts
    """The facts of its labyrinths, for the table."""
    mark: str
    """A hash of the key of the job and of the facts."""

    @classmethod
    def of(cls, job: ShardJob, shard: Shard, facts: Facts) -> Sidecar:
        """Return the sidecar of a finished job."""
        return cls(shard, facts, hashlib.sha256(job.key.encode() + facts.tobytes()).hexdigest())

    @classmethod
    def read(cls, job: ShardJob) -> Sidecar:
        """Read the sidecar in the place of a job's; `is_of` says whether it is that job's.

        Raises:
            FileNotFoundError: The shard is not finished.
            ValueError, RecursionError: The file is damaged.
        """
        content = job.sidecar.read_bytes()
        end = content.index(b"\n")
        line = json.loads(content[:end])
        if not isinstance(line, dict) or line.keys() != {"mark", "shard"}:
            raise ValueError(f"{job.sidecar} marks no shard")
        facts = np.frombuffer(content, FACTS, offset=end + 1)
        return cls(Shard.from_json(line["shard"]), facts, line["mark"])

    def is_of(self, job: ShardJob) -> bool:
        """Return whether a job with the same key left this sidecar, with these facts."""
        return self.mark == Sidecar.of(job, self.shard, self.facts).mark

    def write(self, job: ShardJob) -> None:
        """Write the file that marks the shard as finished."""
        line = json.dumps({"mark": self.mark, "shard": asdict(self.shard)})
        File(job.sidecar).write_bytes(f"{line}\n".encode() + self.facts.tobytes())


def not_as_it_was(path: AnyPath) -> str:
    """Return the error message for a file that was made again with other bytes."""
    return (
        f"{path} cannot be made again with the same bytes: use the library versions in "
        f"{Manifest.FILE}, or give overwrite=true to rebuild the whole dataset"
    )


def finished(job: ShardJob) -> Shard | None:
    """Return the shard of a job if it is finished, None if it must be made.

    Either an earlier run made it, or it is copied from the finished dataset.
    """
    with suppress(FileNotFoundError, ValueError, RecursionError):
        sidecar = Sidecar.read(job)
        if sidecar.is_of(job) and File(job.path).sha256() == sidecar.shard.sha256:
            return sidecar.shard
    old = job.there
    if old is not None and old.table_row is not None:
        with suppress(FileNotFoundError):
            if File(old.path).sha256() == old.shard.sha256:
                with File(job.path).replacing(job.building) as path:
                    shutil.copyfile(str(old.path), path)
                shard = replace(old.shard, path=job.path.name)
                facts = table_facts(old.path.parent, old.table_row, shard.labyrinths)
                Sidecar.of(job, shard, facts).write(job)
                return shard
    return None


def make_shard(job: ShardJob) -> Shard:
    """Make the shard of a job unless it is finished, and return it.

    Raises:
        DatasetError: The finished dataset has the shard with other bytes.
    """
    if (there := finished(job)) is not None:
        return there
    content = Content(job.config, job.split)

    def parts() -> Iterator[list[Row]]:
        for batch in _batches(job):
            solutions = [Solution.of(job.config, job.split, labyrinth) for _, labyrinth, _ in batch]
            for (number, labyrinth, parent), solution in zip(batch, solutions, strict=True):
                info = dump(labyrinth)
                yield from render(job.split, number, info, solution.episodes)
                content.add(info, solution, parent)

    with File(job.path).replacing(job.building) as path:
        fingerprint = write(path, parts())
        size, sha256 = path.stat().st_size, File(path).sha256()
        if job.there is not None and job.there.shard.sha256 != sha256:
            raise DatasetError(not_as_it_was(job.there.path))
    shard = Shard(
        path=job.path.name,
        split=job.split,
        bytes=size,
        sha256=sha256,
        fingerprint=fingerprint,
        **content.counts,
    )
    Sidecar.of(job, shard, content.facts()).write(job)
    return shard


def _batches(job: ShardJob) -> Iterator[list[tuple[int, Labyrinth, Labyrinth | None]]]:
    """Yield the labyrinths of a shard in batches, each with its number and its parent."""
    structures = enumerate(unpack(job.config, job.structures), start=job.first)
    labyrinths = numbered_labyrinths(job.config, job.split, structures)
    together = max(1, CELLS_PER_BATCH // (job.config.height * job.config.width))
    while batch := list(islice(labyrinths, together)):
        yield batch


class Row(NamedTuple):
    """One state of an episode, in the dataset's columns."""

    obs: bytes
    """The picture as a PNG file."""
    obs_path: str
    """The name of the picture, unique in its config."""
    numbers: tuple[Any, ...]
    """The values of `COLUMNS.numbers`."""
    info: str
    picture_digest: bytes
    """The digest of its pixels, which is not a column."""

    @property
    def action(self) -> int:
        """The value of `actions`."""
        action: int = self.numbers[_ACTION]
        return action

    @property
    def starts(self) -> bool:
        """The value of `episode_starts`."""
        return bool(self.numbers[_STARTS])


_ACTION, _STARTS = (
    [column.name for column in COLUMNS.numbers].index(name)
    for name in ("actions", "episode_starts")
)


class Fingerprint:
    """A hash of the values and pixels of rows, in their order.

    It is the SHA-256 of these bytes of each row: the picture's digest, the columns of numbers in
    their order (`actions` as int64, `rewards` as float32, `episode_starts` as one byte; all
    little-endian), and the BLAKE2b hash of `info` in UTF-8, sixteen bytes. It tells whether two
    datasets have the same content, whatever their compression. Unlike the SHA-256 of each file, it
    does not protect against forgery.
    """

    _NUMBERS = struct.Struct("<" + "".join(column.struct for column in COLUMNS.numbers))

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def update(self, rows: Sequence[Row]) -> None:
        """Add rows."""
        texts = {
            info: hashlib.blake2b(info.encode(), digest_size=16).digest()
            for info in {row.info for row in rows}
        }
        parts = [
            digest + self._NUMBERS.pack(*numbers) + texts[info]
            for _, _, numbers, info, digest in rows
        ]
        self._hash.update(b"".join(parts))

    def hexdigest(self) -> str:
        """Return the hash of the rows so far, in hexadecimal digits."""
        return self._hash.hexdigest()


def render(split: str, number: int, info: str, episodes: list[Episode]) -> Iterator[list[Row]]:
    """Yield the rows of each episode of one labyrinth; a long episode is split into parts.

    Args:
        split: The split of the labyrinth.
        number: The index of the labyrinth in the split.
        info: The text of the labyrinth.
        episodes: At least one, all of the same labyrinth.
    """
    pictures = StatePictures(episodes[0].labyrinth)
    for place, episode in enumerate(episodes):
        states, name = episode.states, f"{split}-{number:06d}-{place:03d}"
        names = [f"{name}-{step:04d}.png" for step in range(len(states))]
        columns = [column.values(episode) for column in COLUMNS.numbers if column.values]
        numbers = [*zip(*columns, strict=True)]
        drawn_once = len(episodes) == 1 and len(set(states)) == len(states)
        for first in range(0, len(states), DRAWN_AT_ONCE):
            part = slice(first, first + DRAWN_AT_ONCE)
            if drawn_once:  # 4-5% faster than picture by picture, at 5x5 and at 25x25.
                pngs, digests = pictures.draw(states[part])
            else:
                pngs, digests = zip(*[pictures[state] for state in states[part]], strict=True)
            yield list(map(Row, pngs, names[part], numbers[part], repeat(info), digests))


def write(path: Path, parts: Iterable[list[Row]]) -> str:
    """Write the rows of episodes to a Parquet file, and return their fingerprint.

    Args:
        path: The file.
        parts: The rows of each episode; a long episode may be split into parts.

    Raises:
        OSError: The file cannot be written, say because the disk is full.
    """
    import pyarrow.parquet as pq

    fingerprint, group = Fingerprint(), list[Row]()
    with (
        no_garbage_collection(),
        pq.ParquetWriter(path, written_schema(), **WRITER_OPTIONS) as writer,
    ):
        writer.add_key_value_metadata(COLUMNS.arrow_schema().metadata)
        for part in parts:
            fingerprint.update(part)
            group += part
            if Shard.ends_group(len(group), len(part[-1].obs), part[-1].action):
                writer.write_table(rows_table(group))
                group = []
        if group:
            writer.write_table(rows_table(group))
    return fingerprint.hexdigest()


@contextmanager
def no_garbage_collection() -> Iterator[None]:
    """Switch the garbage collector off; rows hold no reference cycles.

    Collecting garbage costs 5% of a build (1,500 labyrinths at 5x5, CPU time): each collection
    visits all objects of the imported libraries.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def rows_table(rows: list[Row]) -> pa.Table:
    """Return rows as a table that holds each `info` once: it is long, and many rows share it."""
    import pyarrow as pa

    schema = written_schema()
    pngs, names, numbers, infos, _ = zip(*rows, strict=True)
    pictures = pa.StructArray.from_arrays(
        [text_array(pa.binary(), pngs), text_array(pa.string(), [name.encode() for name in names])],
        fields=list(schema.field("obs").type),
    )
    arrays = {"obs": pictures}
    for column, values in zip(COLUMNS.numbers, zip(*numbers, strict=True), strict=True):
        array = np.array(values, column.dtype)
        packed = np.packbits(array, bitorder="little") if column.type == "bool" else array
        arrays[column.name] = value_array(schema.field(column.name).type, len(rows), packed)
    places = {info: number for number, info in enumerate(dict.fromkeys(infos))}
    arrays["info"] = pa.DictionaryArray.from_arrays(
        value_array(pa.int32(), len(rows), np.array([places[info] for info in infos], np.int32)),
        text_array(pa.string(), [info.encode() for info in places]),
    )
    return pa.Table.from_arrays([arrays[name] for name in schema.names], schema=schema)


def written_schema() -> pa.Schema:
    """Return the schema of the tables to write; the texts of `info` are in a dictionary."""
    import pyarrow as pa

    schema = COLUMNS.arrow_schema()
    texts = pa.field("info", pa.dictionary(pa.int32(), pa.string()))
    return schema.set(schema.get_field_index("info"), texts)
