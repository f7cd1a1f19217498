"""`python run.py ...` as a person uses it: one line for a mistake, nothing half-made."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from support.commands import RUN, ended, error_of, refused, run, spaced
from support.making import Run
from support.quick_python import python
from support.tampering import content_of, identities

from labyrinth_core.data import SPLITS, Manifest
from labyrinth_core.version import __version__
from pipeline.command.composed import DEFAULTS, OPTIONS
from pipeline.command.stages import STAGES

resource = pytest.importorskip("resource")  # Not on Windows.
pytestmark = pytest.mark.slow

STEPS = "stages=[build,validate]"

Build = Callable[..., Run]


# Mistakes.


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["sizee=5"], ["sizee is not an option: did you mean size?"]),
        (
            ["stages=[build,train]", "method=custom", "method._target_=mine.Method"],
            ["method._target_=mine.Method: there is no module mine, neither in /"],
        ),
        (["size=${foo}"], ["size", "foo"]),
        (['data_dir="~no-such-user/x"'], ["that user's home folder is unknown"]),
        (["stages=train", "method.epochs=[1,{a:2}]"], ["method.epochs=", "a single value"]),
        (["splits=${oc.env:HOME}"], ["splits=", "splits.NAME="]),
        (["method=[1]"], ["method=[1]: give one name, such as method=bc"]),
    ],
    ids=lambda value: " ".join(value[:2])[:40],
)
def test_a_mistake_is_answered_with_one_line_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], parts: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    error = refused("data_dir=data", *arguments)
    assert all(part in error for part in parts), error
    assert list(tmp_path.iterdir()) == []


def test_a_clone_whose_libraries_are_not_installed_says_so_in_one_line(tmp_path: Path) -> None:
    program = "import sys; sys.modules['hydra'] = None; from pipeline.__main__ import main; main()"
    environment = os.environ | {"PYTHONPATH": str(RUN.parent)}
    result = ended([sys.executable, "-c", program, "size=3"], env=environment, cwd=tmp_path)
    assert error_of(result).startswith("error: hydra is not installed: `pip install .`")


@pytest.mark.parametrize("way_in", [[str(RUN)], ["-m", "pipeline"]], ids=["clone", "installed"])
def test_ctrl_c_while_the_program_is_imported_ends_with_one_line(
    tmp_path: Path, way_in: list[str]
) -> None:
    (tmp_path / "hydra.py").write_text("raise KeyboardInterrupt", encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{RUN.parent}"}
    result = ended([sys.executable, *way_in, "size=3"], env=environment, cwd=tmp_path)
    assert (result.returncode, result.stdout) == (130, "")
    assert result.stderr.startswith("interrupted: ")
    assert len(result.stderr.splitlines()) == 1


def test_no_name_of_a_folder_colours_or_clears_the_terminal(tmp_path: Path) -> None:
    options = ["size=3", "labyrinths=1", "random_steps=5", 'data_dir="a\x1b[2J:fire:\u202eb"']
    made = run(tmp_path, *options, STEPS)
    assert (made.returncode, made.stderr) == (0, "")
    assert r"a\x1b[2J:fire:\u202eb/3x3 is valid: " in spaced(made.stdout)
    missing = run(tmp_path, "stages=[analyse]", 'data_dir="c\x1b[2J"')
    assert error_of(missing).startswith(r"error: c\x1b[2J/5x5 holds no finished dataset")
    assert not {"\x1b", "\u202e"} & {*made.stdout, *missing.stderr}


def test_a_place_that_cannot_be_written_to_is_answered_with_one_line(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("mine")
    for data_dir in ("data", "data/deeper", "/proc/labyrinth"):
        error = error_of(run(tmp_path, "size=3", "labyrinths=1", f"data_dir={data_dir}"))
        if data_dir.startswith("/"):
            assert data_dir in error
        else:
            assert error == "error: data is a file: move it, or choose another folder"
    assert content_of(tmp_path) == {"data": b"mine"}


def limit_of(size: int) -> Callable[[], None]:
    """Return what makes every file of a process end at so many bytes, as a full disk would."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


@pytest.mark.parametrize("size", [0, 2_000])
def test_a_full_disk_is_answered_with_one_line_and_leaves_nothing(
    tmp_path: Path, size: int
) -> None:
    arguments = ["size=3", "labyrinths=8", "data_dir=new/data"]
    error = error_of(run(tmp_path, *arguments, preexec_fn=limit_of(size)))
    assert "new/data" in error
    assert "File too large" in error
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fills_up_leaves_no_dataset_and_the_next_run_goes_on(
    tmp_path: Path, build: Build, small_dataset: Run
) -> None:
    sizes = [shard.bytes for shard in Manifest.read(small_dataset.folder).shards]
    assert max(sizes[:3]) < 10_000 < sizes[3]
    arguments = ["size=3", "labyrinths=8", "data_dir=data", "stages=[build]"]
    error_of(run(tmp_path, *arguments, preexec_fn=limit_of(10_000)))
    assert [path.name for path in (tmp_path / "data").iterdir()] == [".3x3.building"]
    assert not list(tmp_path.rglob("*.tmp"))
    build(tmp_path / "data")
    assert content_of(tmp_path / "data") == content_of(small_dataset.data_dir)


@pytest.mark.parametrize("arguments", [["--help"], ["--cfg", "job"], [], ["size=3", STEPS]])
def test_a_full_output_is_answered_with_one_line_and_a_closed_one_with_none(
    tmp_path: Path, arguments: list[str]
) -> None:
    command = [python(), str(RUN), *arguments, *(["labyrinths=2"] if arguments else [])]
    full = ended(["sh", "-c", f"{shlex.join(command)} > /dev/full"], cwd=tmp_path)
    assert "No space left" in error_of(full)
    piped = f"set -o pipefail; {shlex.join(command)} | true"
    closed = ended(["bash", "-c", piped], cwd=tmp_path)
    assert (closed.returncode, closed.stderr) == (1, "")


# Commands that work.


def test_help_lists_the_options_and_does_nothing_else(tmp_path: Path) -> None:
    version = run(tmp_path, "--version")
    assert (version.returncode, version.stdout) == (0, f"labyrinth-datasets {__version__}\n")
    result = run(tmp_path, "--help")
    assert (result.returncode, result.stderr) == (0, "")
    for name, meaning in OPTIONS.items():
        default = f" [{DEFAULTS[name]}]" if DEFAULTS[name] else ""
        assert f"{name} {spaced(meaning)}{default}" in spaced(result.stdout)
    assert max(map(len, result.stdout.splitlines())) <= 80
    assert list(tmp_path.iterdir()) == []


def test_without_arguments_it_says_what_can_be_done_in_options_that_there_are(
    tmp_path: Path,
) -> None:
    result = run(tmp_path)
    assert (result.returncode, result.stdout.count("\n"), result.stderr) == (0, 10, "")
    assert list(tmp_path.iterdir()) == []
    given = re.findall(r"([\w.]+)=(\S+)", result.stdout)
    assert {name for name, _ in given} <= set(OPTIONS)
    named = [stage for name, value in given if name == "stages" for stage in value.split(",")]
    assert {stage.strip("[]'") for stage in named} <= set(STAGES)


def test_a_run_builds_and_validates_and_a_second_one_changes_no_byte(
    tmp_path: Path, small_dataset: Run
) -> None:
    arguments = ["size=3", "labyrinths=8", "data_dir=data", STEPS]
    first = run(tmp_path, *arguments)
    assert (first.returncode, first.stderr) == (0, "")
    assert "load_dataset('data', '3x3')" in first.stdout
    rows = sum(shard.rows for shard in Manifest.read(small_dataset.folder).shards)
    assert f"data/3x3 is valid: {rows:,} rows replayed." in spaced(first.stdout)
    assert all(split in first.stdout for split in SPLITS.base)
    content = content_of(tmp_path)
    of_the_build = content_of(small_dataset.data_dir)
    assert {name: content[f"data/{name}"] for name in of_the_build} == of_the_build
    assert len(content) == len(of_the_build)
    second = run(tmp_path, *arguments)
    assert (second.returncode, second.stderr) == (0, "")
    assert "data/3x3 is complete already." in spaced(second.stdout)
    assert content_of(tmp_path) == content


def test_the_readme_shows_what_the_main_command_prints(tmp_path: Path) -> None:
    readme = (RUN.parent / "README.md").read_text(encoding="utf-8")
    shown = readme.split("python run.py size=5\n```", 1)[1].split("```")[1]
    printed = re.sub("[^\n -~]", " ", run(tmp_path, "size=5").stdout)  # Without lines of tables.
    lines = [line.split() for line in printed.splitlines()]
    assert [line for line in shown.split("\n")[1:-1] if line.split() not in lines] == []


def test_validation_that_fails_names_the_file_and_makes_the_command_fail(
    tmp_path: Path, small_dataset: Run
) -> None:
    shutil.copytree(small_dataset.data_dir, tmp_path / "data")
    (tmp_path / "data/3x3/test-00000-of-00001.parquet").unlink()
    result = run(tmp_path, "size=3", "data_dir=data", "stages=[validate]")
    assert result.returncode == 1
    assert result.stderr.splitlines() == [
        "error: data/3x3 is not valid:",
        "  test-00000-of-00001.parquet is missing",
    ]


# The end of a process.

ENDED = """
import os, signal, threading, time
from pipeline import __main__
from pipeline.generation import build

signal.signal(signal.SIGINT, signal.default_int_handler)  # nohup or a script's & may ignore it.
make_shard = build.make_shard

def make(job):
    if job.split == "random":
        {end}
    return make_shard(job)

build.make_shard = make
__main__.main()
"""
"""A build that ends before its fourth shard."""

GOES_ON = "run the same command again to resume"


@pytest.mark.parametrize(
    ("end", "status", "said"),
    [
        ("os.kill(os.getpid(), signal.SIGINT); time.sleep(60)", 130, f"interrupted: {GOES_ON}\n"),
        ("os.kill(os.getpid(), signal.SIGKILL)", -signal.SIGKILL, ""),
    ],
    ids=["SIGINT", "SIGKILL"],
)
def test_a_build_that_is_ended_leaves_no_dataset_and_the_next_run_goes_on(
    tmp_path: Path, build: Build, small_dataset: Run, end: str, status: int, said: str
) -> None:
    arguments = ["size=3", "labyrinths=8", "stages=[build]", f"data_dir={tmp_path / 'data'}"]
    done = ended([python(), "-c", ENDED.format(end=end), *arguments], cwd=RUN.parent)
    assert done.returncode == status
    assert re.fullmatch(said, done.stderr), done.stderr
    building = tmp_path / "data" / ".3x3.building"
    left = {path.name for path in (tmp_path / "data").iterdir()}
    # No process holds the lock of a killed one, though its file is there.
    assert left - {".3x3.lock"} == {building.name}
    assert not list(building.rglob("manifest.json"))
    kept = identities(building / "shards")
    assert {name.partition("-")[0] for name in kept} == {"train", "validation", "test"}

    run = build(tmp_path / "data")
    assert content_of(run.data_dir) == content_of(small_dataset.data_dir)
    assert identities(run.folder).items() >= kept.items()


@pytest.mark.parametrize("parts", ["0", "4"])
def test_builds_killed_at_random_moments_end_as_an_undisturbed_one(parts: str) -> None:
    script = RUN.parent / "scripts" / "kill_matrix.py"
    command = [sys.executable, str(script), "--kills", "3", "--workers", "1", "--parts", parts]
    result = ended(command, env=os.environ | {"PYTHONPATH": str(RUN.parent)})
    assert (result.returncode, result.stderr) == (0, "")
    kills = r"^([3-9]|\d\d+) kills, executor=local, workers=\[1\]"
    assert re.search(kills, result.stdout, re.MULTILINE)
    assert "0 datasets differ" in result.stdout


@pytest.mark.programs("bash")
@pytest.mark.parametrize("name", ["a'b", "a,b", 'a"b', "a(b"])
def test_the_line_that_is_to_be_typed_can_be_pasted(tmp_path: Path, name: str) -> None:
    error = error_of(run(tmp_path, f"data_dir={name}"))
    typed = re.search(r"(?:of the shell: |: give )(.*?)(?: for one text, .*)?$", error)
    assert typed is not None
    command = f"{python()} {RUN} {typed[1]} stages=[build] size=2x3 labyrinths=1"
    done = ended(["bash", "-c", command], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["a:b", "./a:b"])
def test_a_folder_may_have_a_colon_in_its_name(tmp_path: Path, name: str) -> None:
    options = ("size=2x3", "labyrinths=2", f"data_dir={name}")
    described = [stage for stage in ("card", "report") if stage in STAGES]
    done = run(tmp_path, *options, f"stages=[{','.join(['build', 'validate', *described])}]")
    assert done.returncode == 0, done.stderr
    (next((tmp_path / "a:b" / "2x3").glob("train-*.parquet"))).unlink()
    assert run(tmp_path, *options, "stages=[build]").returncode == 0
