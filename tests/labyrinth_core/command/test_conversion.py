"""`labyrinth convert`: one labyrinth to the terminal, several into a folder, whole or absent."""

import errno
from pathlib import Path

import numpy as np
import pytest
from support.known_labyrinths import BARE, GRID, LABYRINTH, changed

from labyrinth_core.command.__main__ import main
from labyrinth_core.language import Collection, dump, load

CLOSED = changed(3, 4, 1, BARE)
"""A structure without a route between its corners."""


@pytest.fixture
def run(capsys):
    def run(*arguments):
        status = main(["convert", *map(str, arguments)])
        captured = capsys.readouterr()
        assert "Traceback" not in captured.err
        return status, captured.out, captured.err

    return run


def test_without_marks_start_and_goal_are_in_the_corners(run, tmp_path):
    np.save(tmp_path / "a.npy", BARE)
    assert run(tmp_path / "a.npy") == (0, dump(LABYRINTH), "")


def test_several_become_files_by_split_that_are_read_back(run, tmp_path):
    (folder := tmp_path / "a").mkdir()
    np.save(folder / "train", np.stack([GRID, BARE]))
    np.save(folder / "test", GRID)
    out = tmp_path / "out"
    assert run(folder, "--output", out) == (0, f"{out}: 1 of test, 2 of train\n", "")
    files = sorted(str(file.relative_to(out)) for file in out.glob("*/*"))
    assert files == [
        f"{name}.labyrinth" for name in ("test/000000", "train/000000", "train/000001")
    ]
    assert {load(out / file) for file in files} == {LABYRINTH}
    assert [entry.split for entry in Collection(out)] == ["test", "train", "train"]


def test_what_cannot_be_converted_is_told_and_the_rest_is(run, tmp_path):
    path, out = tmp_path / "a.npy", tmp_path / "out"
    np.save(path, np.stack([changed(0, 1, 0)] * 11 + [CLOSED, GRID]))
    status, printed, told = run(path, "--output", out)
    assert (status, printed) == (1, f"{out}: 1 of a\n")
    lines = told.splitlines()
    assert lines[0] == f"{path}[0]: row 0, column 1: a gap in the outer wall"
    assert lines[10] == "and 2 more"
    assert [file.name for file in out.rglob("*.labyrinth")] == ["000012.labyrinth"]
    np.save(path, CLOSED)
    assert run(path) == (1, "", f"{path}: no route leads from start to goal\n")


def test_an_archive_is_refused_in_one_line_that_says_to_unpack_it(run, tmp_path):
    path = tmp_path / "mazes.zip"
    path.write_bytes(b"PK\3\4 and more")
    problem = f"{path}: unpack this archive and give the folder\n"
    assert run(path) == (1, "", problem)
    nothing = f"labyrinth: {path}: no readable labyrinth; files must end in .labyrinth, .npy\n"
    assert run(path, "--output", tmp_path / "out") == (1, "", problem + nothing)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["two.npy"], "two.npy holds several labyrinths: give --output FOLDER"),
        (["two.npy", "--size", "2x3"], "--size is only for lists of edges"),
        (["two.npy", "--output", "."], "--output .: it already exists; name a new folder"),
        (["two.npy", "--output", "no/where"], "--output no/where: its parent folder does not"),
        (["a.txt", "--output", "out"], "--output is only for folders and files that end in .laby"),
        (["-", "--output", "out"], "--output is only for folders"),
        (["empty"], "empty: no readable labyrinth; files must end in .labyrinth, .npy"),
        (["empty", "--output", "out"], "empty: no readable labyrinth"),
        (["nowhere.npy"], "nowhere.npy: No such file or directory"),
    ],
)
def test_a_mistake_gets_one_line_and_leaves_nothing(run, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    Path("a.txt").write_text("[]")
    np.save("two.npy", np.stack([GRID, GRID]))
    before = sorted(tmp_path.iterdir())
    status, out, err = run(*arguments)
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert err.startswith(f"labyrinth: {message}")
    assert sorted(tmp_path.iterdir()) == before


def test_a_full_disk_leaves_nothing(run, tmp_path, monkeypatch):
    np.save(tmp_path / "two.npy", np.stack([GRID, GRID]))
    write = Path.write_text

    def full(path, *arguments, **options):
        if path.name == "000001.labyrinth":
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        return write(path, *arguments, **options)

    monkeypatch.setattr(Path, "write_text", full)
    status, out, err = run(tmp_path / "two.npy", "--output", tmp_path / "out")
    assert (status, out) == (1, "")
    assert err.endswith("000001.labyrinth: No space left on device\n")
    assert [path.name for path in tmp_path.iterdir()] == ["two.npy"]


@pytest.mark.parametrize("name", ["nothere", "nothere.npy", "nothere.labyrinth", "a/b", "link"])
@pytest.mark.parametrize("option", [[], ["--output", "o"], ["--size", "3"]])
def test_a_file_that_is_not_there_is_named_whatever_the_options_are(
    tmp_path, monkeypatch, capsys, name, option
):
    monkeypatch.chdir(tmp_path)
    Path("link").symlink_to("gone")
    assert main(["convert", name, *option]) == 1
    out, err = capsys.readouterr()
    assert (out, err) == ("", f"labyrinth: {name}: No such file or directory\n")
