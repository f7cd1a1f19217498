"""Labyrinths in files of others: what is read, into which split, and what is said of the rest."""

import pickle
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from wall_grids import BARE, GRID, LABYRINTH, changed, npy, zipped

from labyrinth_core.language.collection import read_collection
from labyrinth_core.language.text import dump
from labyrinth_core.world.labyrinth import Structure

TEXT = dump(LABYRINTH).encode()


def read(path, data=None, **options):
    """Return splits, places within the file, and labyrinths or problems."""
    if data is not None:
        path.write_bytes(data)
    entries = list(read_collection(path, **options))
    assert all((entry.found is None) == bool(entry.problem) for entry in entries)
    assert all(entry.problem.startswith(entry.place) for entry in entries if entry.problem)
    start = len(str(path))
    return [(e.split, e.place[start:], e.found or e.problem[start:]) for e in entries]


def test_splits_are_named_by_sub_folders_then_by_files_then_by_the_folder(tmp_path):
    folder = tmp_path / "mine"
    (folder / "train").mkdir(parents=True)
    np.save(folder / "train" / "a.npy", BARE)
    np.savez(folder / "train" / "b.npz", x=GRID)
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
        ("train", "/train/b.npz: x.npy", LABYRINTH),
        ("train", "/train/c.labyrinth", LABYRINTH),
    ]


def test_an_archive_is_like_a_folder_and_names_of_arrays_are_splits(tmp_path):
    arrays = zipped({"train.npy": npy(np.stack([GRID, GRID])), "../test.npy": npy(GRID)})
    assert read(tmp_path / "a.npz", arrays) == [
        ("labyrinths", ": ../test.npy", LABYRINTH),
        ("train", ": train.npy[0]", LABYRINTH),
        ("train", ": train.npy[1]", LABYRINTH),
    ]
    members = {"train/1.labyrinth": TEXT, "a b/x.npz": arrays, "0.labyrinth": TEXT}
    assert read(tmp_path / "all.zip", zipped(members | {"again.zip": zipped({})})) == [
        ("all", ": 0.labyrinth", LABYRINTH),
        ("a-b", ": a b/x.npz: ../test.npy", LABYRINTH),
        ("a-b", ": a b/x.npz: train.npy[0]", LABYRINTH),
        ("a-b", ": a b/x.npz: train.npy[1]", LABYRINTH),
        ("train", ": train/1.labyrinth", LABYRINTH),
    ]


def test_any_depth_is_read_and_the_first_folder_is_the_split(tmp_path):
    folder, elsewhere = tmp_path / "mine", tmp_path / "elsewhere" / "deep"
    names = ["train/0", "test/hard/0", "test/hard/more/1", "test/1", ".git/2", "test/.old/3"]
    names += [".ipynb_checkpoints/train/0-checkpoint", "train/.ipynb_checkpoints/0-checkpoint"]
    for path in [*(folder / f"{name}.labyrinth" for name in names), elsewhere / "4.labyrinth"]:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(TEXT)
    (folder / "linked").symlink_to(elsewhere.parent)
    (elsewhere / "round").symlink_to(elsewhere.parent)
    expected = [
        ("linked", "/linked/deep/4.labyrinth", LABYRINTH),
        ("test", "/test/1.labyrinth", LABYRINTH),
        ("test", "/test/hard/0.labyrinth", LABYRINTH),
        ("test", "/test/hard/more/1.labyrinth", LABYRINTH),
        ("train", "/train/0.labyrinth", LABYRINTH),
    ]
    assert read(folder) == expected
    members = {f"{name}.labyrinth": TEXT for name in [*names, "linked/deep/4"]}
    members["__MACOSX/train/._0.labyrinth"] = TEXT
    packed = {f"mine/{name}": data for name, data in members.items()}
    for inside in (members, packed):
        found = read(tmp_path / "mine.zip", zipped(inside))
        assert [each[0] for each in found] == [each[0] for each in expected]
    assert read(
        tmp_path / "test.zip", zipped({"test/a.npy": npy(GRID), "train/b.npy": npy(GRID)})
    ) == [
        ("test", ": test/a.npy", LABYRINTH),
        ("train", ": train/b.npy", LABYRINTH),
    ]


def test_a_folder_that_cannot_be_read_is_not_left_out_in_silence(tmp_path, monkeypatch):
    def refused(path):
        raise PermissionError(13, "Permission denied", str(path))

    (tmp_path / "test").mkdir()
    whole = Path.iterdir
    monkeypatch.setattr(Path, "iterdir", lambda p: refused(p) if p.name == "test" else whole(p))
    with pytest.raises(PermissionError):
        read(tmp_path)


def test_an_array_may_hold_connections_of_maze_dataset(tmp_path):
    passages = np.zeros((2, 2, 2, 2), np.bool_)
    passages[1, 0, 1] = True  # Below the bottom row.
    found = [each for _, _, each in read(tmp_path / "a.npy", npy(passages))]
    assert found == [Structure(2, 2, 0, 0), "[1]: a passage leads out of the grid"]


def test_what_cannot_be_read_is_told_with_its_place_and_the_rest_is_read(tmp_path):
    grids = np.stack([GRID, changed(1, 3, 1), changed(3, 4, 1), GRID])
    arrays = {"a.npy": npy(grids), "b.npy": npy(np.zeros(3)), "c.npy": b"nothing"}
    found = read(tmp_path / "many.npz", zipped(arrays | {"d.npy": npy(GRID)}))
    unread = [(place, each) for _, place, each in found if isinstance(each, str)]
    assert len(found) == 7
    assert unread == [
        (": a.npy[1]", ": a.npy[1]: row 1, column 3: a wall where a cell is"),
        (": a.npy[2]", ": a.npy[2]: no route leads from start to goal"),
        (": b.npy", unread[2][1]),
        (": c.npy", unread[3][1]),
    ]
    assert unread[2][1].startswith(": b.npy: an array of the shape (3,): expected a wall grid")
    assert unread[3][1].startswith(": c.npy: no array that can be read: ")
    ((split, place, problem),) = read(tmp_path / "x.labyrinth", b"labyrinth:\n---\n")
    assert (split, place) == ("x", "")
    assert problem.startswith(":2:1: the top line of the drawing has the wrong length")


class Trap:
    """An object whose pickle says so if it is opened."""

    def __reduce__(self):
        return pytest.fail, ("something was unpickled",)


CLAIM = npy(GRID).replace(b"(5, 7), }" + b" " * 12, b"(5" + b"0" * 12 + b", 7), }")
"""An array that says that it is much larger than any memory."""


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.npy", pickle.dumps(Trap()), "no array that can be read: "),
        ("a.npy", npy(np.array([None])), "no array that can be read: Object arrays cannot be"),
        ("a.npy", npy(np.array(["#"])), "expected an array of booleans or numbers, found <U1"),
        ("a.npy", npy(GRID)[:-9], "no array that can be read: "),
        ("a.npy", npy(GRID).replace(b"(5, 7)", b"(1e7,)"), "no array that can be read: "),
        ("a.npy", npy(np.zeros((10**8, 0, 0))), "an array of the shape (100000000, 0, 0), which "),
        ("a.npy", CLAIM, "no array that can be read: "),
        ("a.npy", npy(GRID).replace(b"}  ", b"}]["), "no array that can be read: "),
        ("a.npz", npy(GRID), "no zip archive that can be read: "),
        ("a.npz", zipped({"a.npy": npy(GRID)}).replace(b"\1\1", b"\1\2"), "a.npy: it cannot be"),
    ],
    ids=count(),  # Archives hold the time.
)
def test_what_is_no_such_file_is_told_in_one_line_and_never_unpickled(
    tmp_path, name, data, message
):
    ((_, _, problem),) = read(tmp_path / name, data)
    assert problem.removeprefix(": ").startswith(message)
    assert "\n" not in problem


def test_no_more_is_read_or_unpacked_than_may_be(tmp_path):
    grids = np.stack([GRID] * 100)
    np.savez_compressed(tmp_path / "a.npz", a=grids)
    np.save(tmp_path / "b.npy", grids)
    assert [each for _, _, each in read(tmp_path, max_bytes=1_000)] == [
        "/a.npz: a.npy: it has more than 1,000 bytes",
        "/b.npy: it has more than 1,000 bytes",
    ]
