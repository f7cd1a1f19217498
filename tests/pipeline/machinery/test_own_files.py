"""Files that a stage left, told from those of a person."""

from __future__ import annotations

from pathlib import Path

import pytest

from labyrinth_core.data.errors import DatasetError
from pipeline.machinery.own_files import HASHES, OwnFiles, is_litter, write_list


def left(folder: Path, **files: bytes) -> OwnFiles:
    """Return the files of a folder after a stage has left these."""
    own = OwnFiles.read(folder, always="page")
    now = own.replace(files, gone={name for name, _ in own.hashes} - set(files))
    write_list(folder, now.hashes)
    return OwnFiles.read(folder, always="page")


def content_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != HASHES}


def test_what_was_left_may_be_replaced_and_removed(tmp_path: Path) -> None:
    left(tmp_path, page=b"1", chart=b"1")
    own = left(tmp_path, page=b"2")
    assert content_of(tmp_path) == {"page": b"2"}
    assert own.others({"page": b"3", "chart": b"3"}) == []


def test_what_a_person_made_or_changed_is_told_and_never_removed(tmp_path: Path) -> None:
    left(tmp_path, page=b"1", chart=b"1", table=b"1")
    (tmp_path / "chart").write_bytes(b"mine")
    (tmp_path / "photo").write_bytes(b"mine")
    (tmp_path / "folder").mkdir()
    own = OwnFiles.read(tmp_path, always="page")
    new = dict.fromkeys(["page", "chart", "photo", "folder", "table", "more"], b"2")
    assert own.others(new) == ["chart", "photo", "folder"]
    (tmp_path / "folder").rmdir()
    left(tmp_path, page=b"2")
    assert content_of(tmp_path) == {"page": b"2", "chart": b"mine", "photo": b"mine"}


@pytest.mark.parametrize("names", [("chart", "page/impossible"), ("page/impossible", "chart")])
def test_files_that_an_interrupted_run_has_written_are_still_known(
    tmp_path: Path, names: tuple[str, str]
) -> None:
    own = left(tmp_path, page=b"1", chart=b"1")
    with pytest.raises(OSError, match="page"):
        own.replace(dict.fromkeys(names, b"2"), gone=[])
    own = OwnFiles.read(tmp_path, always="page")
    assert own.others({"page": b"3", "chart": b"3"}) == []


@pytest.mark.parametrize("text", ["", f"{'0' * 64}  thesis.txt\n", "page is mine\n", "\0\xff"])
def test_a_list_of_somebody_else_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / HASHES).write_text(text, encoding="latin-1")
    with pytest.raises(DatasetError, match=r"\A.*SHA256SUMS is somebody else's: move it.*\Z"):
        OwnFiles.read(tmp_path, always="page")


@pytest.mark.parametrize(
    ("path", "litter"),
    [
        *((".DS_Store", True), ("Thumbs.db", True), ("desktop.ini", True), ("._page", True)),
        *((".ipynb_checkpoints/notes.txt", True), ("meta/.nfs000000000012ab", True)),
        *(("cache-0123456789abcdef.arrow", True), ("data/cache-1_00000_of_00002.arrow", True)),
        *((".hidden", False), ("cache.arrow", False), ("cache-notes.txt", False)),
        *(("notes.DS_Store", False), ("Thumbs.db.txt", False), ("desktop/notes.txt", False)),
    ],
)
def test_what_systems_and_readers_leave_is_told_from_files_of_a_person(
    path: str, litter: bool
) -> None:
    assert is_litter(path) == litter
