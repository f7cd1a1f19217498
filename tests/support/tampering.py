"""Changes to finished shards, which only a look at the rows themselves can find."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from labyrinth_core.data import COLUMNS, Dataset, Manifest
from labyrinth_core.language import dump, parse
from labyrinth_core.pictures import PICTURE_SIZE, Painter, PictureDigest
from labyrinth_core.pictures.png import strips_of
from labyrinth_core.storage import File
from labyrinth_core.world import Labyrinth, Solver
from pipeline.generation.check import validate
from pipeline.generation.labyrinths import toggled, walls
from pipeline.generation.shard import Fingerprint, Row

Rows = list[dict[str, Any]]

TRAIN = "train-00000-of-00001.parquet"
OTHER, TEST, RANDOM, S0, MOVED = (
    f"{split}-00000-of-00001.parquet"
    for split in ("validation", "test", "random", "s0", "s0_and_g")
)
"""Files; the labyrinths of the first are not the parents of others."""


def content_of(folder: Path) -> dict[str, bytes]:
    """Return the bytes of all files in a folder, by their names."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def cut_short(path: Path) -> None:
    """Remove the last byte of a file."""
    path.write_bytes(path.read_bytes()[:-1])


def linked(folder: Path, store: Path) -> dict[str, bytes]:
    """Put the files of a folder into a store, a link in the place of each; return the store's."""
    for path in [each for each in folder.rglob("*") if each.is_file()]:
        place = store / path.relative_to(folder)
        place.parent.mkdir(parents=True, exist_ok=True)
        path.rename(place)
        path.symlink_to(place)
    return content_of(store)


def folder_behind_link(link: Path, tmp_path: Path) -> Path:
    """Make a link to a new empty folder elsewhere; return that folder."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    link.symlink_to(elsewhere)
    return elsewhere


def identities(folder: Path) -> dict[str, tuple[int, int]]:
    """Return what shows that the shards in a folder have not been written again, by their names."""
    return {
        path.name: (path.stat().st_ino, path.stat().st_mtime_ns) for path in folder.glob("*-of-*")
    }


def read_rows(path: Path) -> Rows:
    return pq.read_table(path).to_pylist()


@contextmanager
def rows_of(folder: Path, file: str = TRAIN) -> Iterator[Rows]:
    """Lend the rows of a shard to be changed, then write them, and a manifest that agrees."""
    rows = read_rows(folder / file)
    yield rows
    pq.write_table(pa.Table.from_pylist(rows, schema=COLUMNS.arrow_schema()), folder / file)
    agree(folder, file, rows)


def put_shards(
    folder: Path,
    split: str,
    tables: Sequence[pa.Table],
    groups_of: Callable[[pa.Table], Iterable[int]] = lambda _: [0],
) -> None:
    """Make tables the shards of a split, in the manifest as well.

    Args:
        folder: The folder of the dataset.
        split: The split.
        tables: The content of each shard.
        groups_of: Returns the first row of each row group of a table.
    """
    manifest = Manifest.read(folder)
    old = manifest.of(split)
    for shard in old:
        (folder / shard.path).unlink()
    shards = [shard for shard in manifest.shards if shard.split != split]
    for number, table in enumerate(tables):
        path = folder / f"{split}-{number:05d}-of-{len(tables):05d}.parquet"
        with pq.ParquetWriter(path, table.schema) as writer:
            for begin, end in pairwise([*groups_of(table), len(table)]):
                writer.write_table(table.slice(begin, end - begin), row_group_size=end - begin)
        made = {"path": path.name, "rows": len(table), "bytes": path.stat().st_size}
        made |= {"sha256": File(path).sha256()}
        if "info" in table.column_names:
            made |= {"labyrinths": len(table["info"].unique())}
        shards.append(replace(old[min(number, len(old) - 1)], **made))
    replace(manifest, shards=tuple(shards)).write(folder)


@contextmanager
def manifest_of(folder: Path) -> Iterator[dict[str, Any]]:
    """Lend the content of a manifest to be changed, then write it, with its fingerprint."""
    content = json.loads((folder / Manifest.FILE).read_bytes())
    yield content
    parts = [f"{shard['split']}:{shard['fingerprint']}" for shard in content["shards"]]
    content["fingerprint"] = hashlib.sha256("\n".join(parts).encode()).hexdigest()
    (folder / Manifest.FILE).write_text(json.dumps(content))


def agree(folder: Path, file: str, rows: Rows) -> None:
    """Make the manifest say of a shard what is true now."""
    starts = episode_starts(rows)
    infos = [rows[start]["info"] for start in starts]
    values = {
        "labyrinths": 1 + sum(one != other for one, other in pairwise(infos)),
        "episodes": len(starts),
        "rows": len(rows),
        "longest": max(end - start for start, end in pairwise([*starts, len(rows)])) - 1,
        "bytes": (folder / file).stat().st_size,
        "sha256": File(folder / file).sha256(),
        "fingerprint": fingerprint(rows),
    }
    with manifest_of(folder) as content:
        next(shard for shard in content["shards"] if shard["path"] == file).update(values)


def episode_starts(rows: Rows) -> list[int]:
    return [0] + [n for n, row in enumerate(rows) if n and row["episode_starts"]]


def fingerprint(rows: Iterable[dict[str, Any]]) -> str:
    """Return the fingerprint of rows, whatever their pictures are."""
    fingerprint = Fingerprint()
    for row in rows:
        numbers = tuple(row[column.name] for column in COLUMNS.numbers)
        digest = picture_digest_of(row["obs"]["bytes"])
        fingerprint.update([Row(b"", "", numbers, row["info"], digest)])
    return fingerprint.hexdigest()


@lru_cache(20_000)  # Tests change a few pictures of the same dataset.
def picture_digest_of(png: bytes) -> bytes:
    if strips := strips_of(png, PICTURE_SIZE):
        return PictureDigest(strips).digest({})
    try:  # Of another encoder. Pillow takes five milliseconds.
        picture = np.array(Image.open(io.BytesIO(png)).convert("RGB"))
        return PictureDigest.of(picture)
    except (OSError, SyntaxError):
        return b"not a picture at all"


def episode_rows(split: str, number: int, labyrinth: Labyrinth, actions: list[int]) -> Rows:
    """Return the rows of an episode, right in everything."""
    episode = labyrinth.replay(actions)
    painter = Painter(labyrinth)
    numbers = {column.name: column.values(episode) for column in COLUMNS if column.values}
    return [
        {
            "obs": {
                "bytes": painter.png(state),
                "path": f"{split}-{number:06d}-000-{step:04d}.png",
            },
            **{name: values[step] for name, values in numbers.items()},
            "info": dump(labyrinth),
        }
        for step, state in enumerate(episode.states)
    ]


def with_a_wall_opened(labyrinth: Labyrinth) -> Labyrinth:
    """Return the labyrinth with the first of its walls opened."""
    structure = labyrinth.structure
    return replace(labyrinth, structure=toggled(structure, *next(walls(structure))))


def replace_first(folder: Path, split: str, change: Callable[[Labyrinth], Labyrinth]) -> None:
    """Change the first labyrinth of a split, with its demonstration."""
    with rows_of(folder, f"{split}-00000-of-00001.parquet") as rows:
        first = [row for row in rows if row["info"] == rows[0]["info"]]
        number = int(first[0]["obs"]["path"].split("-")[1])
        labyrinth = change(parse(first[0]["info"]))
        route = Solver(labyrinth).shortest_routes()[0]
        rows[: len(first)] = episode_rows(split, number, labyrinth, route)


def problems(folder: Path) -> list[str]:
    """Return what validation finds, each problem in one short line."""
    found = validate(Dataset.at(folder, renamed=True))
    assert all("\n" not in problem and len(problem) < 500 for problem in found)
    return found


def names(found: list[str], row: int, field: str, file: str = TRAIN) -> bool:
    """Return whether a problem with a field of a row is among those that were found."""
    return any(problem.startswith(f"{file} row {row} {field}: ") for problem in found)
