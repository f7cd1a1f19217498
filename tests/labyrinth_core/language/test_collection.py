"""Labyrinths in files of others: what is read, into which split, and what is said of the rest."""

import errno
import os
import pickle
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from support.known_labyrinths import BARE, GRID, LABYRINTH, changed, npy

from labyrinth_core.language import dump
from labyrinth_core.language.collection import read_collection
from labyrinth_core.world import Structure

TEXT = dump(LABYRINTH).encode()


def read(path, data=None):
    """Return splits, places within the file, and labyrinths or problems."""
    if data is not None:
        path.write_bytes(data)
    entries = list(read_collection(path))
    assert all((entry.found is None) == bool(entry.problem) for entry in entries)
    assert all(entry.problem.startswith(entry.place) for entry in entries if entry.problem)
    start = len(str(path))
    return [(e.split, e.place[start:], e.found or e.problem[start:]) for e in entries]


def test_splits_are_named_by_sub_folders_then_by_files_then_by_the_folder(tmp_path):
    folder = tmp_path / "mine"
    (folder / "train").mkdir(parents=True)
    np.save(folder / "train" / "a.npy", BARE)
    (folder / "train" / "b.NPY").write_bytes(npy(GRID))
    (folder / "train" / "c.labyrinth").write_bytes(TEXT)
    np.save(folder / "test.npy", np.stack([GRID, BARE]))
    (folder / "one.LABYRINTH").write_bytes(TEXT)
    (folder / ".hidden.labyrinth").write_bytes(TEXT)
    (folder / "notes.txt").write_text("not read")
    structure = LABYRINTH.structure
    assert read(folder) == [
        ("mine", "/one.LABYRINTH", LABYRINTH),
        ("test", "/test.npy[0]", LABYRINTH),
        ("test", "/test.npy[1]", structure),
        ("train", "/train/a.npy", structure),
        ("train", "/train/b.NPY", LABYRINTH),
        ("train", "/train/c.labyrinth", LABYRINTH),
    ]


@pytest.mark.parametrize("name", ["a.zip", "a.npz", "a.tar", "a.tar.gz", "a.TGZ"])
def test_an_archive_is_to_be_unpacked_and_the_files_beside_it_are_read(tmp_path, name):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / name).write_bytes(b"anything")
    (folder / "b.labyrinth").write_bytes(TEXT)
    problem = ": unpack this archive and give the folder"
    assert [(place, found) for _, place, found in read(folder)] == [
        (f"/{name}", f"/{name}{problem}"),
        ("/b.labyrinth", LABYRINTH),
    ]
    assert [each for _, _, each in read(folder / name)] == [problem]


def test_any_depth_is_read_and_the_first_folder_is_the_split(tmp_path):
    folder, elsewhere = tmp_path / "mine", tmp_path / "elsewhere" / "deep"
    names = ["train/0", "test/hard/0", "test/hard/more/1", "test/1", ".git/2", "test/.old/3"]
    names += [".ipynb_checkpoints/train/0-checkpoint", "train/.ipynb_checkpoints/0-checkpoint"]
    for path in [*(folder / f"{name}.labyrinth" for name in names), elsewhere / "4.labyrinth"]:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(TEXT)
    (folder / "linked").symlink_to(elsewhere.parent)
    (elsewhere / "round").symlink_to(elsewhere.parent)
    assert read(folder) == [
        ("linked", "/linked/deep/4.labyrinth", LABYRINTH),
        ("test", "/test/1.labyrinth", LABYRINTH),
        ("test", "/test/hard/0.labyrinth", LABYRINTH),
        ("test", "/test/hard/more/1.labyrinth", LABYRINTH),
        ("train", "/train/0.labyrinth", LABYRINTH),
    ]


def test_folders_that_storage_servers_and_desktops_leave_are_no_splits(tmp_path):
    for name in ("train", "@eaDir", "train/@eaDir", "#recycle", "__MACOSX/test"):
        (tmp_path / name).mkdir(parents=True, exist_ok=True)
        (tmp_path / name / "a.labyrinth").write_bytes(TEXT)
    assert [entry.split for entry in read_collection(tmp_path)] == ["train"]


def test_what_cannot_be_read_is_a_problem_with_its_place_and_the_rest_is_read(
    tmp_path, monkeypatch
):
    def refused(path):
        raise PermissionError(13, "Permission denied", str(path))

    folder = tmp_path / "mine"
    for split in ("locked", "test"):
        (folder / split).mkdir(parents=True)
        (folder / split / "1.labyrinth").write_bytes(TEXT)
    (folder / "test" / "2.labyrinth").symlink_to("/nowhere/2.labyrinth")
    (folder / "test" / "3.npy").symlink_to("3.npy")
    (folder / "test" / "unread.labyrinth").write_bytes(TEXT)
    (folder / "train").symlink_to("../unplugged")
    os.mkfifo(folder / "waits.labyrinth")
    iterdir, opened = Path.iterdir, Path.open
    monkeypatch.setattr(Path, "iterdir", lambda p: refused(p) if p.name == "locked" else iterdir(p))
    monkeypatch.setattr(
        Path, "open", lambda p, *a: refused(p) if "unread" in p.name else opened(p, *a)
    )
    leads = ": a link that leads nowhere: "
    assert [(place, found) for _, place, found in read(folder)] == [
        ("/locked", "/locked: Permission denied"),
        ("/test/1.labyrinth", LABYRINTH),
        ("/test/2.labyrinth", f"/test/2.labyrinth{leads}{os.strerror(errno.ENOENT)}"),
        ("/test/3.npy", f"/test/3.npy{leads}{os.strerror(errno.ELOOP)}"),
        ("/test/unread.labyrinth", "/test/unread.labyrinth: Permission denied"),
        ("/train", f"/train{leads}{os.strerror(errno.ENOENT)}"),
        ("/waits.labyrinth", "/waits.labyrinth: it is not a regular file"),
    ]


def test_folders_that_links_reach_in_many_ways_are_listed_once_in_a_split(tmp_path):
    folder = tmp_path / "mine"
    names = [f"{number:02}" for number in range(24)]
    for name, after in zip(names, names[1:] + names[:1], strict=True):
        (folder / name).mkdir(parents=True)
        for link in ("a", "b"):
            (folder / name / link).symlink_to(folder / after)
    (folder / "23" / "one.labyrinth").write_bytes(TEXT)
    found = read(folder)
    assert sorted(split for split, _, _ in found) == names  # A link shows the leak between splits.
    assert {each for _, _, each in found} == {LABYRINTH}


def test_an_array_may_hold_connections_of_maze_dataset(tmp_path):
    passages = np.zeros((2, 2, 2, 2), np.bool_)
    passages[1, 0, 1] = True  # Below the bottom row.
    found = [each for _, _, each in read(tmp_path / "a.npy", npy(passages))]
    assert found == [Structure(2, 2, 0, 0), "[1]: a passage leads out of the grid"]


def test_what_cannot_be_read_is_told_with_its_place_and_the_rest_is_read(tmp_path):
    grids = np.stack([GRID, changed(1, 3, 1), changed(3, 4, 1), GRID])
    arrays = {"a.npy": npy(grids), "b.npy": npy(np.zeros(3)), "c.npy": b"nothing"}
    for name, data in (arrays | {"d.npy": npy(GRID)}).items():
        (tmp_path / name).write_bytes(data)
    found = read(tmp_path)
    unread = [(place, each) for _, place, each in found if isinstance(each, str)]
    assert len(found) == 7
    assert unread == [
        ("/a.npy[1]", "/a.npy[1]: row 1, column 3: a wall where a cell is"),
        ("/a.npy[2]", "/a.npy[2]: no route leads from start to goal"),
        ("/b.npy", unread[2][1]),
        ("/c.npy", unread[3][1]),
    ]
    assert unread[2][1].startswith("/b.npy: an array of shape (3,): expected a wall grid")
    assert unread[3][1].startswith("/c.npy: the array cannot be read: ")
    ((split, place, problem),) = read(tmp_path / "x.labyrinth", b"labyrinth:\n---\n")
    assert (split, place) == ("x", "")
    assert problem.startswith(":2:1: the top line of the drawing has the wrong length")


class Trap:
    """An object whose pickle says so if it is opened."""

    def __reduce__(self):
        return pytest.fail, ("something was unpickled",)


CLAIM = npy(GRID).replace(b"(5, 7), }" + b" " * 12, b"(5" + b"0" * 12 + b", 7), }")
"""An array that says that it is much larger than any memory."""


CLAIMS = (b"2**70", b"%d" % 2**70, b"-1", b"1,'a'", b"(" * 500 + b")" * 500, b"1e400", b"None")
DESCRIBED = b"{'descr': '|u1', 'fortran_order': False, 'shape': (%s,)}"


def header(literal):
    """Return a .npy file, version 1.0, with a header that NumPy parses."""
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(literal)) + literal + bytes(99)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (pickle.dumps(Trap()), "the array cannot be read: "),
        (npy(np.array([None])), "the array cannot be read: Object arrays cannot be"),
        (npy(np.array(["#"])), "expected an array of booleans or numbers, found <U1"),
        (npy(GRID)[:-9], "the array cannot be read: "),
        (npy(GRID).replace(b"(5, 7)", b"(1e7,)"), "the array cannot be read: "),
        (npy(np.zeros((10**8, 0, 0))), "an empty array of shape (100000000, 0, 0)"),
        (CLAIM, "the array cannot be read: "),
        (npy(GRID).replace(b"}  ", b"}]["), "the array cannot be read: "),
        (header(b"{[]: 1}"), "the array cannot be read: unhashable"),
        (header(b"{'descr': '|u1', 1: 2, b'': 3}"), "the array cannot be read: "),
        *((header(DESCRIBED % claim), "the array cannot be read: ") for claim in CLAIMS),
    ],
)
def test_what_is_no_such_file_is_told_in_one_line_and_never_unpickled(tmp_path, data, message):
    ((_, _, problem),) = read(tmp_path / "a.npy", data)
    assert problem.removeprefix(": ").startswith(message)
    assert "\n" not in problem


def test_no_more_is_read_than_may_be(tmp_path):
    np.save(tmp_path / "a.npy", GRID)
    os.truncate(tmp_path / "a.npy", 2**28 + 1)  # It is sparse, so it takes no space on the disk.
    np.save(tmp_path / "b.npy", GRID)
    assert [each for _, _, each in read(tmp_path)] == [
        "/a.npy: it has more than 268,435,456 bytes",
        LABYRINTH,
    ]


def test_no_problem_quotes_a_file_outside_the_folder_that_a_link_leads_to(tmp_path):
    folder = tmp_path / "mine"
    (folder / "train").mkdir(parents=True)
    secret = tmp_path / "key"
    for content in (b"hunter2 is the password", b"hunter2\n", b"hunter2: true", b"\xffhunter2"):
        secret.write_bytes(content)
        for name in ("a.labyrinth", "b.npy"):
            (folder / "train" / name).unlink(missing_ok=True)
            (folder / "train" / name).symlink_to(secret)
        problems = [entry.problem for entry in read_collection(folder)]
        assert len(problems) == 2
        assert not any(re.search("hunt|0xff", problem) for problem in problems)
    (folder / "train" / "own.labyrinth").write_bytes(b"hunter2 is here")
    (*_, entry) = read_collection(folder)
    assert "found 'hunter2'" in entry.problem
