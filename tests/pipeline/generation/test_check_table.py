"""Validation finds what is wrong with the table of labyrinths."""

from __future__ import annotations

import io
import shutil
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.making import Run
from support.tampering import TRAIN, manifest_of, problems, read_rows, rows_of

from labyrinth_core.data import TABLE_COLUMNS, Dataset, Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import File

pytestmark = pytest.mark.slow


@pytest.fixture(scope="session")
def made(build: Callable[..., Run], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset with six labyrinths a split, in three shards each."""
    folder = tmp_path_factory.mktemp("made")
    return build(folder, labyrinths=6, random_steps=20, cells_per_shard=2 * 9).folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """A copy of it, to be tampered with."""
    return Path(shutil.copytree(made, tmp_path / made.name))


def write(folder: Path, table: pa.Table, *, agree: bool = True, **options: int) -> None:
    """Write the table, and a manifest that agrees."""
    path = folder / Manifest.TABLE
    pq.write_table(table, path, **options)
    if agree:
        with manifest_of(folder) as content:
            content["labyrinths"] = {"bytes": path.stat().st_size, "sha256": File(path).sha256()}


def test_a_table_that_is_right_has_no_problems_however_it_is_written(folder: Path) -> None:
    assert problems(folder) == []
    write(folder, pq.read_table(folder / Manifest.TABLE))
    assert problems(folder) == []


def test_a_value_that_was_changed_in_any_column_is_named_with_its_row(folder: Path) -> None:
    """A column is changed in the first row, the next column two rows below, and so on."""
    rows, expected = read_rows(folder / Manifest.TABLE), set()
    for row, name in zip([*range(0, 36, 2), 35], rows[0], strict=True):
        old = rows[row][name]
        new = "0123456789abcdef" if isinstance(old, str) or name == "parent_id" else (old or 0) + 1
        rows[row][name] = new
        expected.add(f"{Manifest.TABLE} row {row} {name}: {new!r}, but the shard gives {old!r}")
    write(folder, pa.Table.from_pylist(rows, schema=TABLE_COLUMNS.arrow_schema()))
    found = problems(folder)
    assert {*found} == expected
    assert len(found) == len(TABLE_COLUMNS)


def test_what_only_the_hash_shows_is_found(folder: Path) -> None:
    write(folder, pq.read_table(folder / Manifest.TABLE), agree=False)
    (problem,) = problems(folder)
    assert problem.startswith(f"{Manifest.TABLE}: sha256 ")
    with pytest.raises(DatasetError, match="damaged: its sha256 is not the manifest's"):
        Dataset.at(folder).check_table()


def test_a_table_of_other_columns_or_of_fewer_rows_is_found(folder: Path) -> None:
    table = pq.read_table(folder / Manifest.TABLE)
    write(folder, table.drop_columns(["loops"]))
    assert problems(folder) == [
        f"{Manifest.TABLE}: its columns are not those of a table of labyrinths"
    ]
    write(folder, table.slice(1))
    assert problems(folder) == [f"{Manifest.TABLE}: 35 rows, but the manifest has 36 labyrinths"]


@pytest.mark.parametrize("content", [b"", b"PAR1" * 9, None])
def test_a_table_that_is_missing_or_no_parquet_file_is_found(
    folder: Path, content: bytes | None
) -> None:
    (folder / Manifest.TABLE).unlink()
    if content is not None:
        (folder / Manifest.TABLE).write_bytes(content)
    (problem,) = problems(folder)
    assert problem.startswith(
        f"{Manifest.TABLE} {'is missing' if content is None else 'cannot be read: '}"
    )


def test_rows_that_are_wrong_are_reported_once(folder: Path) -> None:
    first = TRAIN.replace("00001.", "00003.")
    with rows_of(folder, first) as rows:
        rows[0]["actions"] = (rows[0]["actions"] + 1) % 4
    found = problems(folder)
    assert found
    assert all(problem.startswith(first) for problem in found)


def test_the_table_is_read_in_no_thread_of_arrow(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such a thread may abort the process when the interpreter ends."""
    threads: Counter[int] = Counter()

    class Noting(io.FileIO):
        def read(self, size: int | None = -1, /) -> bytes | None:
            threads[threading.get_ident()] += 1
            return super().read(-1 if size is None else size)

    opened = Path.open

    def noting(path: Path, mode: str = "r", **options: Any) -> Any:
        return Noting(path) if path.name == Manifest.TABLE else opened(path, mode, **options)

    write(folder, pq.read_table(folder / Manifest.TABLE), row_group_size=1)
    monkeypatch.setattr(Path, "open", noting)
    assert problems(folder) == []
    assert set(threads) == {threading.get_ident()}
