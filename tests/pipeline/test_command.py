"""What a command does with errors of all kinds, and with a sweep of several runs."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from commands import RUN, run, spaced
from quick_python import python

from labyrinth_core.data.manifest import Manifest

pytestmark = pytest.mark.slow

FAULTY = """
import sys
from omegaconf.errors import OmegaConfBaseException
from pipeline import __main__
from pipeline.generation import build

def run(run):
    raise {error}('my own')

build.run = run
sys.exit(__main__.main())
"""
"""The program with a stage that fails."""


@pytest.mark.parametrize("sweep", [[], ["-m", "seed=1,2"]], ids=["run", "sweep"])
@pytest.mark.parametrize(
    "error",
    ["ValueError", "TypeError", "OSError", "KeyError", "OmegaConfBaseException"],
)
def test_a_bug_of_a_stage_gets_its_traceback_whatever_its_type(
    tmp_path: Path, error: str, sweep: list[str]
) -> None:
    done = subprocess.run(
        [python(), "-c", FAULTY.format(error=error), *sweep, "stages=build"],
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
