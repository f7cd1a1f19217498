"""Labyrinths in files of others: what is read, into which split, and what is told of the rest."""

import json
import pickle
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from wall_grids import COLOURS, GRID, LABYRINTH, changed, npy, png_of, zipped

from labyrinth_core.language import stored_arrays
from labyrinth_core.language.collection import read_collection
from labyrinth_core.language.maze_dataset import from_connections
from labyrinth_core.language.text import dump
from labyrinth_core.language.wall_grid import from_grid

MAZES = Path(__file__).parents[2] / "data" / "maze_dataset"
"""Six mazes as maze-dataset 1.4.2 saved them, without their settings, and as it draws them."""

BARE = np.where(GRID > 1, 0, GRID)
OTHER = changed(3, 4, 1, BARE)
PNG = png_of(COLOURS[GRID])


def drawn(text):
    """Return the labyrinth of a drawing of maze-dataset's."""
    elements = {"#": 1, "S": 2, "E": 3}
    return from_grid(np.array([[elements.get(char, 0) for char in row] for row in text.split()]))


def six_mazes():
    text = (MAZES / "mazes.txt").read_text(encoding="utf-8").replace(" ", "X")
    return [drawn(each) for each in text.split("\n\n")]


def read(path, data=None):
    """Return splits, places within the file, and labyrinths or problems."""
    if data is not None:
        path.write_bytes(data)
    entries = list(read_collection(path))
    assert all((entry.found is None) == bool(entry.problem) for entry in entries)
    assert all(entry.problem.startswith(entry.place) for entry in entries if entry.problem)
    start = len(str(path))
    return [(e.split, e.place[start:], e.found or e.problem[start:]) for e in entries]


@pytest.mark.parametrize("name", ["full", "minimal", "minimal_soln_cat"])
def test_the_files_of_maze_dataset_hold_the_mazes_that_it_draws(name):
    found = read(MAZES / f"{name}.zanj")
    assert found == [(name, f"[{index}]", maze) for index, maze in enumerate(six_mazes())]


def test_splits_are_named_by_sub_folders_then_by_files_then_by_the_folder(tmp_path):
    folder = tmp_path / "mine"
    (folder / "train").mkdir(parents=True)
    np.save(folder / "train" / "a.npy", BARE)
    np.savez(folder / "train" / "b.npz", x=GRID)
    (folder / "train" / "c.labyrinth").write_text(dump(LABYRINTH), encoding="utf-8")
    np.save(folder / "test.npy", np.stack([GRID, BARE]))
    (folder / "one.PNG").write_bytes(PNG)
    (folder / ".hidden.png").write_bytes(PNG)
    (folder / "notes.txt").write_text("not read")
    structure = LABYRINTH.structure
    assert read(folder) == [
        ("mine", "/one.PNG", LABYRINTH),
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
    members = {"train/1.png": PNG, "a b/x.npz": arrays, "0.png": PNG, "again.zip": zipped({})}
    assert read(tmp_path / "all.zip", zipped(members)) == [
        ("all", ": 0.png", LABYRINTH),
        ("a-b", ": a b/x.npz: ../test.npy", LABYRINTH),
        ("a-b", ": a b/x.npz: train.npy[0]", LABYRINTH),
        ("a-b", ": a b/x.npz: train.npy[1]", LABYRINTH),
        ("train", ": train/1.png", LABYRINTH),
    ]


def connections_of(structure):
    """Return the connections of a structure as maze-dataset has them."""
    height, width = structure.height, structure.width
    connections = np.zeros((2, height, width), np.bool_)
    for cell, neighbour in structure.passages():
        beside = neighbour == cell + 1
        place = cell if beside else neighbour
        connections[(int(beside), height - 1 - place // width, place % width)] = True
    return connections


def test_an_array_may_hold_connections_of_maze_dataset(tmp_path):
    connections = connections_of(LABYRINTH.structure)
    outside = connections.copy()
    outside[0, -1, 0] = True
    found = read(tmp_path / "a.npy", npy(np.stack([connections, outside])))
    assert [each for _, _, each in found] == [
        LABYRINTH.structure,
        "[1]: a passage leads out of the grid",
    ]
    assert from_connections(connections, np.array([[1, 0], [0, 0], [0, 2]])) == LABYRINTH


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


def zanj(**content):
    return zipped({"__zanj__.json": json.dumps({"__muutils_format__": "MazeDataset", **content})})


CLAIM = npy(GRID).replace(b"(5, 7), }" + b" " * 12, b"(5" + b"0" * 12 + b", 7), }")
"""An array that says that it is much larger than any memory."""
NO_MAZE = "no mazes that can be read: "


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.npy", pickle.dumps(Trap()), "no array that can be read: "),
        ("a.npy", npy(np.array([None])), "no array that can be read: Object arrays cannot be"),
        ("a.npy", npy(np.array(["#"])), "expected an array of booleans or numbers, found <U1"),
        ("a.npy", npy(GRID)[:-9], "no array that can be read: "),
        ("a.npy", npy(GRID).replace(b"(5, 7)", b"(1e7,)"), "no array that can be read: "),
        ("a.npy", CLAIM, "no array that can be read: "),
        ("a.npy", npy(GRID).replace(b"}  ", b"}]["), "no array that can be read: "),
        ("a.npz", npy(GRID), "no zip archive that can be read: "),
        ("a.npz", zipped({"a.npy": npy(GRID)}).replace(b"\1\1", b"\1\2"), "a.npy: it cannot be"),
        ("a.zanj", zipped({}), "no mazes that can be read: ValueError: it cannot be unpacked"),
        ("a.zanj", zipped({"__zanj__.json": "[" * 10**5}), f"{NO_MAZE}RecursionError"),
        ("a.zanj", zanj(), f"{NO_MAZE}KeyError: 'mazes'"),
        ("a.zanj", zanj(mazes=[{"connection_list": 1}]), f"{NO_MAZE}ValueError: expected an array"),
        ("a.zanj", zanj(mazes={"$ref": "../secret"}), f"{NO_MAZE}ValueError: it cannot be"),
        (
            "a.zanj",
            zanj(mazes=[{"connection_list": [[[1, 0], [0, 1]]], "solution": [[0, 0]]}]),
            "[0]: its connections have the shape (1, 2, 2): expected (2, rows, columns), both",
        ),
        (
            "a.zanj",
            zanj(mazes=[{"connection_list": [[[0, 0]] * 2] * 2, "solution": [[0, 0], [0, 2]]}]),
            "[0]: its solution begins or ends outside the grid",
        ),
        (
            "a.zanj",
            zanj(mazes=[{"connection_list": [[[2, 2]] * 2] * 2, "solution": [1]}]),
            "[0]: its connections are not all 0 or 1",
        ),
        (
            "a.zanj",
            zanj(mazes=[{"connection_list": [[[0, 0]] * 2] * 2, "solution": [1]}]),
            "[0]: its solution is no list of cells",
        ),
        (
            "a.zanj",
            zanj(__muutils_format__="MazeDatasetCollection"),
            "expected a MazeDataset, found MazeDatasetCollection",
        ),
    ],
    ids=count(),  # Archives hold the time.
)
def test_what_is_no_such_file_is_told_in_one_line_and_never_unpickled(
    tmp_path, name, data, message
):
    ((_, _, problem),) = read(tmp_path / name, data)
    assert problem.removeprefix(": ").startswith(message)
    assert "\n" not in problem


def test_no_more_is_read_or_unpacked_than_may_be(tmp_path, monkeypatch):
    grids = np.stack([GRID] * 100)
    np.savez_compressed(tmp_path / "a.npz", a=grids)
    np.save(tmp_path / "b.npy", grids)
    monkeypatch.setattr(stored_arrays, "MAX_BYTES", 1_000)
    assert [each for _, _, each in read(tmp_path)] == [
        "/a.npz: a.npy: it has more than 1,000 bytes",
        "/b.npy: it has more than 1,000 bytes",
    ]
