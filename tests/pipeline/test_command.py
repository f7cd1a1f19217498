"""What a command does with errors of all kinds, and with a sweep of several runs."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from commands import RUN, run, spaced
from quick_python import python

from labyrinth_core.data.manifest import Manifest

pytestmark = pytest.mark.slow

PROGRAM = """
import sys
from omegaconf.errors import OmegaConfBaseException
from pipeline import __main__
from pipeline.generation import build

def run(run):
    {stage}

build.run = run
sys.exit(__main__.main())
"""
"""The program with another stage."""


@pytest.mark.parametrize("sweep", [[], ["-m", "seed=1,2"]], ids=["run", "sweep"])
@pytest.mark.parametrize(
    "error",
    ["ValueError", "TypeError", "OSError", "KeyError", "OmegaConfBaseException"],
)
def test_a_bug_of_a_stage_gets_its_traceback_whatever_its_type(
    tmp_path: Path, error: str, sweep: list[str]
) -> None:
    done = subprocess.run(
        [python(), "-c", PROGRAM.format(stage=f"raise {error}('my own')"), *sweep, "stages=build"],
        env={"PYTHONPATH": str(RUN.parent), "TMPDIR": str(tmp_path)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "error:" not in done.stderr
    runs = 2 if sweep else 1
    assert done.stderr.count("Traceback (most recent call last):") == runs
    assert len(re.findall(r"^[\w.]+: '?my own'?$", done.stderr, re.MULTILINE)) == runs


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252"])
def test_no_message_fails_for_want_of_a_character(tmp_path: Path, encoding: str) -> None:
    stage = r"from pipeline.machinery.console import say; say('50 \u00b1 1 \u2026 \u0416')"
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            PROGRAM.format(stage=stage),
            "-m",
            "stages=build",
            'data_dir="\u0416"',
        ],
        env={"PYTHONPATH": str(RUN.parent), "PYTHONIOENCODING": encoding, "PYTHONUTF8": "1"},
        cwd=tmp_path,
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")
    expected = "50 \u00b1 1 \u2026 \u0416".encode(encoding, "backslashreplace")
    assert expected in done.stdout


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&-", "<&- >&- 2>&-"])
def test_what_the_shell_has_closed_changes_nothing(tmp_path: Path, closed: str) -> None:
    options = ["size=2x3", "labyrinths=2", "workers=2", "stages=[build,validate]"]
    command = shlex.join([sys.executable, str(RUN), *options])
    done = subprocess.run(f"{command} {closed}", shell=True, cwd=tmp_path, check=False)
    assert done.returncode == 0
    assert (tmp_path / "data/labyrinth/2x3/manifest.json").is_file()


def test_a_sweep_builds_each_size_and_task(tmp_path: Path) -> None:
    options = ["size=3,2x4", "task=navigation,partial_observability"]
    arguments = [
        *options,
        "labyrinths=1",
        "random_steps=5",
        "data_dir=data",
        "stages=[build,validate]",
    ]
    result = run(tmp_path, "-m", *arguments)
    assert (result.returncode, result.stderr) == (0, "")
    names = {f"{size}{task}" for size in ("3x3", "2x4") for task in ("", "-partial_observability")}
    assert {path.name for path in (tmp_path / "data").iterdir()} == names | {"README.md"}
    for name in names:
        manifest = Manifest.read(tmp_path / "data" / name)
        assert (manifest.config.name, manifest.config.labyrinths) == (name, 1)
        assert f"data/{name} is valid" in spaced(result.stdout)


def test_a_run_that_fails_does_not_end_a_sweep_but_makes_the_command_fail(tmp_path: Path) -> None:
    options = ["size=2,3", "task=icy_floor,navigation", "labyrinths=1", "random_steps=5"]
    result = run(tmp_path, "-m", *options, "data_dir=data", "stages=[build]")
    assert result.returncode == 1
    errors = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert "size=2x2" in errors[0]
    assert "Traceback" not in result.stderr
    assert (tmp_path / "data" / "3x3" / "manifest.json").is_file()
