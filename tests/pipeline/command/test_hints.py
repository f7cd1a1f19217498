"""The command lines that a command suggests to do next."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from support.commands import RUN, run
from support.making import Run, RunConfig, resolve
from support.quick_python import python

from pipeline.command.launch import next_command
from pipeline.command.stages import STAGES


@pytest.mark.slow
@pytest.mark.parametrize(
    "shell", [pytest.param(name, marks=pytest.mark.programs(name)) for name in ("bash", "zsh")]
)
def test_one_stage_needs_no_brackets_and_ends_with_a_command_that_works_next(
    small_dataset: Run, tmp_path: Path, shell: str
) -> None:
    shutil.copytree(small_dataset.data_dir, tmp_path / "my data's")
    (tmp_path / "my own").mkdir()
    (tmp_path / "my own/small.yaml").write_text(
        "defaults: [config, _self_]\nsize: 3\nlabyrinths: 8"
    )
    flags = ["--config-name=small", "--config-dir", "my own"]
    printed = run(tmp_path, *flags, "stages=build", """data_dir="my data's\"""").stdout
    purpose, _, hint = printed.splitlines()[-1].partition(": ")
    assert purpose == "Next, to check every row and describe the dataset"
    assert hint.startswith(
        f"python {RUN} --config-name=small '--config-dir={tmp_path}/my own' size=3"
    )
    path = f"{Path(python()).parent}{os.pathsep}{os.environ['PATH']}"  # Has a `python`.
    env = os.environ | {"PATH": path}
    pasted = subprocess.run([shell, "-fc", hint], cwd=tmp_path, env=env, check=False)
    assert pasted.returncode == 0
    assert (tmp_path / "my data's" / "README.md").is_file()


def suggested(options: RunConfig, given: list[str]) -> list[str]:
    """Return the lines that a command with these options ends with."""
    run = resolve(options)
    last = run.options.stages[-1]
    match STAGES[last].next_step(run, run.options.stages):
        case (line,):
            return [line]
        case (added, purpose):
            return [next_command(run.options, added, purpose, given)]
    return []


@pytest.mark.parametrize(
    ("stages", "expected"),
    [
        (["build"], "Next, to check every row and describe the dataset: "),
        *[(["build", "card"], "Next, to look at it in a browser: ")]
        * ({"card", "report"} <= STAGES.keys()),
        *[(["train", "evaluate"], "Next, to compare it with others: ")] * ("results" in STAGES),
        (["validate"], None),
    ],
)
def test_a_build_and_an_evaluation_say_what_can_be_done_next_and_no_other_stage(
    stages: list[str], expected: str | None
) -> None:
    given = ["size=3", "stages=[x]", "+overwrite=true", "method.epochs=2", "seed=1"]
    lines = suggested(RunConfig(stages=tuple(stages), size="3", seed=1), given)
    assert len(lines) == (expected is not None)
    for line in lines:
        assert line.startswith(str(expected))
        words = shlex.split(line.partition(": ")[2])
        *_, size, seed, named = words
        assert (size, seed) == ("size=3", "seed=1")
        stages = named.partition("=")[2].strip("[]").split(",")
        resolve(RunConfig(stages=tuple(stages), size="3"))


def test_a_hint_has_values_in_place_of_references_and_can_be_typed() -> None:
    options = RunConfig(stages=("build",), data_dir="runs/${x} a", seed=3, size="3")
    given = ["size=3", "seed=3", r"data_dir=runs/$\{seed\}", "+experiment=paper", "~goals"]
    (line,) = suggested(options, given)
    words = shlex.split(line.partition(": ")[2])
    assert words[-6:-1] == [
        *("size=3", "seed=3", r'data_dir="runs/\${x} a"', "+experiment=paper", "goals=fixed")
    ]


def test_the_next_command_repeats_only_options_that_its_stages_use() -> None:
    options = RunConfig(size="3", run_dir="own", threads=1)
    given = ["size=3", "run_dir=own", "threads=1", "hydra.verbose=true"]
    line = next_command(options, "stages=build", "see", given)
    assert line.endswith(" size=3 run_dir=own hydra.verbose=true stages=build")


def test_a_stage_whose_wing_was_taken_out_is_not_suggested() -> None:
    options = RunConfig(size="3")
    assert next_command(options, "stages=gone", "see", []) == ""
    assert next_command(options, "stages=build,gone", "see", []).endswith("size=3 stages=build")


def test_an_evaluation_on_another_dataset_which_the_tables_ignore_suggests_no_tables() -> None:
    options = RunConfig(stages=("evaluate",), size="3", evaluate_on="data/other/4x4")
    assert suggested(options, ["size=3"]) == []
