import io
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from labyrinth_core.command.__main__ import main
from labyrinth_core.command.commands import COMMANDS
from labyrinth_core.language import dump, parse
from labyrinth_core.version import __version__
from labyrinth_core.world import ALGORITHMS, Task

ROOT = Path(__file__).parents[3]
DATA = ROOT / "tests" / "data"
NAVIGATION = str(DATA / "valid" / "figure_1a_navigation.labyrinth")
KEY_AND_DOOR = str(DATA / "valid" / "figure_1c_key_and_door.labyrinth")
INVALID = str(DATA / "invalid" / "unknown_tile.labyrinth")
COMMAND = [sys.executable, "-m", "labyrinth_core.command"]


@pytest.fixture
def run(capsys):
    def run(*arguments):
        status = main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run


@pytest.fixture
def refused(run):
    """Run a command that has to end with status 1 and one message, and return that."""

    def refused(*arguments):
        status, out, err = run(*arguments)
        assert status == 1
        assert out == ""
        assert err.count("\n") == 1
        assert "Traceback" not in err
        return err

    return refused


def test_check_says_size_task_and_route_length_of_each_file(run):
    status, out, err = run("check", NAVIGATION, KEY_AND_DOOR)
    assert status == 0
    assert out == (
        f"{NAVIGATION}: ok, 3x3, navigation, 4 moves\n"
        f"{KEY_AND_DOOR}: ok, 3x3, key_and_door, 8 moves\n"
    )
    assert err == ""


def test_a_labyrinth_is_solved(run):
    assert run("solve", NAVIGATION) == (0, "4 moves: up right up right\n", "")


def test_check_goes_on_after_a_file_that_failed(run, tmp_path):
    status, out, err = run("check", INVALID, tmp_path, "/nowhere/at/all", NAVIGATION)
    assert status == 1
    assert out.count(": ok, ") == 1
    assert err.startswith(f"{INVALID}:7:3: in a line of cells: expected ")
    assert f"labyrinth: {tmp_path}: Is a directory\n" in err
    assert err.endswith("labyrinth: /nowhere/at/all: No such file or directory\n")


def test_a_dash_reads_standard_input_and_mistakes_name_it(run, monkeypatch):
    text = Path(NAVIGATION).read_bytes()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text)))
    assert run("check", "-") == (0, "-: ok, 3x3, navigation, 4 moves\n", "")
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"\xff")))
    status, _, err = run("check", "-")
    assert status == 1
    assert err.startswith("<stdin>:1:1: the file is not text: expected UTF-8, found the byte 0xff")


def test_show_marks_a_shortest_route(run):
    status, out, _ = run("show", NAVIGATION, "--solution")
    assert status == 0
    assert "|   | .   E |\n|   +   + - |\n| .   .     |\n|   + - +   |\n| S     |   |" in out


def test_show_colours_on_a_terminal_unless_no_color_is_set(run, monkeypatch):
    monkeypatch.setattr(type(sys.stdout), "isatty", lambda _: True)
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert "\x1b[1;31mS\x1b[0m" in run("show", NAVIGATION)[1]
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b" not in run("show", NAVIGATION)[1]


def test_show_writes_a_picture_with_the_solution_if_it_is_asked_for(run, tmp_path):
    plain, solved = tmp_path / "plain.png", tmp_path / "solved.png"
    assert run("show", KEY_AND_DOOR, "--png", plain) == (0, "", "")
    assert run("show", KEY_AND_DOOR, "--png", solved, "--solution") == (0, "", "")
    for path in (plain, solved):
        with Image.open(path) as picture:
            assert (picture.size, picture.mode) == ((600, 600), "RGB")
    assert plain.read_bytes() != solved.read_bytes()


WALLED = """
labyrinth:
---------
| %s |   |
|   +   |
| S | E |
---------
end
"""


@pytest.mark.parametrize(
    ("settings", "tile", "reason"),
    [
        ("", " ", "no route leads from start to goal"),
        ("icy_floor: True", "I", "no route without ice leads from start to goal"),
        ("key_and_lock: True", "K", "no route leads from start to goal"),
        ("occlusion: True", " ", "no route leads from start to goal"),
    ],
)
def test_what_cannot_be_solved_is_drawn_with_the_reason(run, tmp_path, settings, tile, reason):
    path, picture = tmp_path / "walled.labyrinth", tmp_path / "walled.png"
    path.write_text(settings + WALLED % tile)
    status, out, err = run("show", path)
    assert (status, reason in err) == (1, True)
    assert f"| {tile} |   |\n|   +   |\n| S | E |" in out
    assert settings in out
    assert run("show", path, "--png", picture)[:2] == (1, "")
    with Image.open(picture) as shown:
        assert shown.size == (600, 600)
    for flags in (["--solution"], ["--gif", tmp_path / "x.gif"]):
        status, out, err = run("show", path, *flags)
        assert (status, out, reason in err) == (1, "", True)
    assert run("check", path)[0] == 1


@pytest.mark.parametrize("task", Task)
def test_a_blank_drawing_has_no_walls_and_no_tiles(run, tmp_path, task):
    status, out, err = run("new", "--blank", "--size", "2x3", "--task", task)
    assert (status, err) == (0, "")
    assert out.endswith(
        "labyrinth:\n-------------\n|         E |\n|   +   +   |\n| S         |\n"
        "-------------\nend\n"
    )
    assert out.count("True") == (task is not Task.NAVIGATION)
    (tmp_path / "blank.labyrinth").write_text(out)
    assert run("show", tmp_path / "blank.labyrinth")[1] == out


def test_a_picture_that_cannot_be_is_refused_in_one_line(run, refused, tmp_path):
    path = tmp_path / "large.labyrinth"
    path.write_text(run("new", "--size", "2x400")[1])
    assert "a picture has room for" in refused("show", path, "--png", tmp_path / "x.png")
    path = tmp_path / "picture.jpg"
    assert "give a name that ends in .png" in refused("show", NAVIGATION, "--png", path)
    assert not path.exists()


def test_the_version_is_printed(run):
    assert run("--version") == (0, f"labyrinth {__version__}\n", "")


def test_solve_prints_every_route_without_a_loop(run, tmp_path):
    path = tmp_path / "open.labyrinth"
    path.write_text(run("new", "--size", "2x3", "--open-walls", "1")[1])
    status, out, err = run("solve", path, "--all")
    assert (status, err) == (0, "")
    assert out == (
        "3 moves: up right right\n"
        "3 moves: right up right\n"
        "3 moves: right right up\n"
        "5 moves: up right down right up\n"
    )
    assert run("solve", path, "--all", "--limit", "4") == (0, out, "")
    status, out, err = run("solve", path, "--all", "--limit", "2")
    assert (status, out.count("\n")) == (0, 2)
    assert err == "labyrinth: stopped after 2 routes (--limit)\n"


@pytest.mark.parametrize("task", Task)
@pytest.mark.parametrize("sampler", ALGORITHMS)
def test_new_prints_a_labyrinth_of_the_task(run, task, sampler):
    arguments = ("new", "--size", "5x6", "--task", task, "--sampler", sampler, "--seed", "1")
    status, out, err = run(*arguments, "--open-walls", "0.2")
    assert (status, err) == (0, "")
    labyrinth = parse(out)
    assert (labyrinth.task, labyrinth.size_name) == (task, "5x6")
    assert dump(labyrinth) == out
    assert run(*arguments, "--open-walls", "0.2")[1] == out


def test_new_without_a_seed_prints_another_one_each_time(run):
    assert len({run("new", "--size", "8")[1] for _ in range(3)}) == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["new", "--size", "0"], "argument --size: size=0: give a whole number from 2 to 1,000"),
        (["new", "--open-walls", "2"], "argument --open-walls: '2': give a probability"),
        (
            ["new", "--size", "9", "--task", "icy-floor", "--open-walls", "0"],
            "labyrinth: open_walls=0 task=icy_floor: ",
        ),
        (
            ["new", "--size", "2", "--task", "icy-floor"],
            "goal=(1, 1): none of 10,000 random labyrinths",
        ),
        (["new", "--blank", "--seed", "0"], "labyrinth: --blank needs no --sampler, "),
        (["new", "--blank", "--sampler", "prim"], "labyrinth: --blank needs no --sampler, "),
        (["new", "--task", "maze"], "argument --task: 'maze': choose one of navigation, "),
        (["new", "--seed", "-1"], "argument --seed: '-1': give a whole number from 0 on"),
        (["new", "--sampler", "maze"], "sampler=maze: choose one of wilson, "),
        (["solve", NAVIGATION, "--all", "--limit", "0"], "argument --limit: '0': give a whole"),
        (["solve", NAVIGATION, "--limit", "3"], "labyrinth: --limit needs --all\n"),
        (["check"], "the following arguments are required: FILE"),
        (["fly"], "argument COMMAND: invalid choice: 'fly'"),
        ([], "the following arguments are required: COMMAND"),
        (["solve", "/nowhere"], "/nowhere: No such file or directory"),
        (
            ["show", NAVIGATION, "--gif", "x.png"],
            "argument --gif: 'x.png': give a name that ends in",
        ),
    ],
)
def test_a_mistake_of_the_user_gets_one_message(refused, monkeypatch, arguments, message):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO()))
    assert message in refused(*arguments)


def test_show_writes_a_moving_picture_of_a_shortest_route(run, tmp_path):
    path, picture = tmp_path / "open.labyrinth", tmp_path / "one.gif"
    path.write_text(run("new", "--size", "2x3", "--open-walls", "1")[1])
    still = tmp_path / "one.png"
    assert run("show", path, "--gif", picture, "--png", still) == (0, "", "")
    assert still.exists()
    with Image.open(picture) as shown:
        assert (shown.n_frames, shown.size) == (4, (300, 300))


def test_convert_reads_a_list_of_edges_and_names_its_mistakes(run, tmp_path):
    path = tmp_path / "edges.txt"
    path.write_text("[(0, 1), (1, 2), (0, 3), (2, 5)];(0, 0);(1, 2);[(1, 0)]\n")
    status, out, err = run("convert", path, "--size", "2x3")
    assert (status, err) == (0, "")
    assert "icy_floor: True" in out
    assert "| I |   | E |\n|   + - +   |\n| S         |" in out
    path.write_text("[(0, 1)")
    assert run("convert", path)[2].startswith(f"{path}:1:8: in a list of edges: expected ")


@pytest.mark.parametrize("command", [[], *([name] for name in COMMANDS)])
def test_help_ends_with_status_0(run, command):
    status, out, _ = run(*command, "--help")
    assert status == 0
    assert out.startswith("usage: labyrinth")


def test_the_help_of_new_names_every_sampler_and_task(run):
    out = " ".join(run("new", "--help")[1].split())
    assert all(name in out for name in [*ALGORITHMS, *Task])


def test_help_does_without_numpy():
    code = "import sys; from labyrinth_core.command.__main__ import main; main(['--help']); "
    code += "sys.exit('numpy' in sys.modules)"
    assert (
        subprocess.run([sys.executable, "-c", code], capture_output=True, cwd=ROOT).returncode == 0
    )


def test_ctrl_c_ends_with_status_130(capsys, monkeypatch):
    def interrupt(_):
        raise KeyboardInterrupt

    monkeypatch.setitem(COMMANDS, "check", interrupt)
    monkeypatch.setattr(sys, "argv", ["labyrinth", "check", NAVIGATION])
    assert (main(), *capsys.readouterr()) == (130, "", "")


def test_no_name_of_a_file_colours_or_clears_the_terminal(run, tmp_path):
    name = "a\x1b[2J\x9b\u202e\udcff b"
    file = tmp_path / f"{name}.labyrinth"
    spelt = r"a\x1b[2J\x9b\u202e\udcff b.labyrinth"
    status, out, err = run("check", tmp_path / "none", file)
    assert (status, out) == (1, "")
    assert f"{tmp_path}/{spelt}: No such file" in err
    file = tmp_path / "a\x1b[2J.labyrinth"
    file.write_text("nonsense", encoding="utf-8")
    assert rf"{tmp_path}/a\x1b[2J.labyrinth:1:1: " in run("check", file)[2]
    file.write_bytes(Path(NAVIGATION).read_bytes())
    assert run("check", file)[1].startswith(rf"{tmp_path}/a\x1b[2J.labyrinth: ok, 3x3, ")
    assert r"\x1b[2J" in run("\x1b[2J")[2]


def test_no_name_of_a_file_forges_a_line_of_the_terminal(run, tmp_path):
    folder = tmp_path / "a\nfile: ok"
    folder.mkdir()
    file = folder / "1.labyrinth"
    spelt = rf"{tmp_path}/a\nfile: ok"
    assert run("check", file)[2].count("\n") == 1
    file.write_bytes(Path(NAVIGATION).read_bytes())
    assert run("check", file)[1].count("\n") == 1
    (folder / "2.labyrinth").write_text("nonsense", encoding="utf-8")
    assert run("check", folder / "2.labyrinth")[2].startswith(f"{spelt}/2.labyrinth:1:1: ")
    _, out, err = run("convert", folder, "--output", tmp_path / "new\nline")
    assert (out.count("\n"), err.count("\n")) == (1, 1)
    _, out, err = run("convert", folder, "--output", folder)
    assert (out, err.count("\n")) == ("", 1)
    assert run("a\nb")[2].count("\n") == 1


def test_standard_output_that_the_shell_has_closed_changes_nothing():
    command = f"{shlex.join([*COMMAND, 'check', str(NAVIGATION)])} >&-"
    result = subprocess.run(command, shell=True, stderr=subprocess.PIPE, timeout=60)
    assert (result.returncode, result.stderr) == (0, b"")


def test_a_reader_that_has_gone_causes_no_traceback():
    reading, writing = os.pipe()
    os.close(reading)
    process = subprocess.run(
        [*COMMAND, "solve", NAVIGATION], stdout=writing, stderr=subprocess.PIPE, cwd=ROOT
    )
    os.close(writing)
    assert (process.returncode, process.stderr) == (1, b"")
