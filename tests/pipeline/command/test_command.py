"""What a command does with errors of all kinds, and with a sweep of several runs."""

from __future__ import annotations

import errno
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from support.commands import RUN, ended, error_of, refused, run, spaced
from support.making import Run
from support.quick_python import python
from support.tampering import content_of

from labyrinth_core.data import Manifest
from pipeline.command.stages import STAGES
from pipeline.config import Job

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


def run_with(folder: Path, stage: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Return what became of the program in a folder with another stage."""
    environment = {"PYTHONPATH": str(RUN.parent), "TMPDIR": str(folder)}
    command = [python(), "-c", PROGRAM.format(stage=stage), *arguments]
    return ended(command, env=environment, cwd=folder)


BUGS = ["ValueError", "TypeError", "OSError", "KeyError", "OmegaConfBaseException"]


@pytest.mark.parametrize("seeds", ["0", "0,1,2,3,4"])
def test_a_bug_of_a_stage_gets_its_traceback_whatever_its_type(tmp_path: Path, seeds: str) -> None:
    stage = f"raise ({', '.join(BUGS)})[run.dataset.seed]('my own')"
    sweep = ["-m"] if "," in seeds else []
    done = run_with(tmp_path, stage, *sweep, f"seed={seeds}", "stages=build")
    assert done.returncode == 1
    assert "error:" not in done.stderr
    runs = 5 if sweep else 1
    assert done.stderr.count("Traceback (most recent call last):") == runs
    assert len(re.findall(r"^[\w.]+: '?my own'?$", done.stderr, re.MULTILINE)) == runs


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.ESTALE])
def test_a_fault_of_a_disk_whose_file_is_not_named_is_told_in_one_line(
    tmp_path: Path, number: int
) -> None:
    reason = os.strerror(number)
    done = run_with(tmp_path, f"raise OSError({number}, {reason!r})", "size=3")
    told = "once that is fixed, run the same command again to resume"
    assert error_of(done) == f"error: {reason}: {told}"


def test_a_folder_for_temporary_files_that_is_missing_is_told_in_one_line(tmp_path: Path) -> None:
    stage = """import tempfile
    tempfile._candidate_tempdir_list = lambda: ["/nowhere"]
    tempfile.tempdir = None
    tempfile.gettempdir()"""
    done = run_with(tmp_path, stage, "stages=build")
    assert error_of(done) == "error: No usable temporary directory found in ['/nowhere']"


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
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


@pytest.mark.parametrize(("closed", "workers"), [(">&-", 1), ("2>&-", 1), ("<&- >&- 2>&-", 2)])
def test_what_the_shell_has_closed_changes_nothing(
    tmp_path: Path, closed: str, workers: int
) -> None:
    options = ["size=2x3", "labyrinths=2", f"workers={workers}", "stages=[build,validate]"]
    command = shlex.join([sys.executable, str(RUN), *options])
    done = subprocess.run(f"{command} {closed}", shell=True, cwd=tmp_path, check=False)
    assert done.returncode == 0
    assert (tmp_path / "data/labyrinth/2x3/manifest.json").is_file()


def test_a_run_that_fails_does_not_end_a_sweep_but_makes_the_command_fail(tmp_path: Path) -> None:
    options = ["size=2,3", "task=icy_floor,navigation", "labyrinths=1", "random_steps=5"]
    result = run(tmp_path, "-m", *options, "data_dir=data", "stages=[build]")
    assert result.returncode == 1
    errors = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert "size=2x2" in errors[0]
    assert "Traceback" not in result.stderr
    assert (tmp_path / "data" / "3x3" / "manifest.json").is_file()


@pytest.mark.parametrize(
    "begin", ["labyrinths=1 -m", "--multi labyrinths=1", "labyrinths=1 hydra.mode=MULTIRUN"]
)
def test_a_sweep_builds_each_size_and_task_and_leaves_its_record(
    tmp_path: Path, begin: str
) -> None:
    options = ["size=3,2x4", "task=navigation,partial_observability", "random_steps=5"]
    options += ["data_dir=data", "stages=[build,validate]"]
    result = run(tmp_path, *begin.split(), *options)
    assert (result.returncode, result.stderr) == (0, "")
    names = {f"{size}{task}" for size in ("3x3", "2x4") for task in ("", "-partial_observability")}
    assert {path.name for path in (tmp_path / "data").iterdir()} == names | {"README.md"}
    for name in names:
        manifest = Manifest.read(tmp_path / "data" / name)
        assert (manifest.config.name, manifest.config.labyrinths) == (name, 1)
        assert f"data/{name} is valid" in spaced(result.stdout)
    assert {path.name for path in tmp_path.iterdir()} == {"data", "multirun"}
    (record,) = (tmp_path / "multirun").rglob("*.yaml")
    assert record.name == "multirun.yaml"


def test_a_folder_that_a_user_gives_for_a_sweep_is_used(tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.mkdir()
    mine = "defaults: [config, _self_]\nsize: 2x3\nlabyrinths: 1\nhydra: {sweep: {dir: of_file}}"
    (own / "mine.yaml").write_text(mine)
    flags = ["--config-dir", "own", "--config-name", "mine", "-m", "stages=build"]
    for given, used in ([], "of_file"), (["hydra.sweep.dir=typed"], "typed"):
        result = run(tmp_path, *flags, *given)
        assert (result.returncode, result.stderr) == (0, "")
        assert (tmp_path / used / "multirun.yaml").is_file()


def test_texts_stay_as_typed_in_each_run_of_a_sweep(tmp_path: Path) -> None:
    stage = """import yaml
    options = yaml.safe_load(run.composed())
    print('read', options['revision'], options['dataset'], options['evaluation']['name'])
"""
    swept = ["revision=1.10,1.1,1e3", "dataset=choice(1.0,true)", "evaluation.name=true"]
    done = run_with(tmp_path, stage, "-m", "stages=build", *swept)
    assert (done.returncode, done.stderr) == (0, "")
    read = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("read")]
    revisions, datasets = ("1.10", "1.1", "1e3"), ("1.0", "true")
    assert read == [[one, other, "true"] for one in revisions for other in datasets]


LAUNCHER = """
from hydra.core.plugins import Plugins
from hydra.core.utils import run_job
from hydra.plugins.launcher import Launcher
from joblib import Parallel, delayed


def start(number, overrides, context, config, task, state):
    from hydra.core.singleton import Singleton
    from hydra.core.utils import setup_globals

    setup_globals()
    Singleton.set_state(state)
    job = context.config_loader.load_sweep_config(config, overrides)
    job.hydra.job.id, job.hydra.job.num = str(number), number
    where = {"job_dir_key": "hydra.sweep.dir", "job_subdir_key": "hydra.sweep.subdir"}
    return run_job(hydra_context=context, task_function=task, config=job, **where)


class Elsewhere(Launcher):
    def setup(self, *, hydra_context, task_function, config):
        self.given = hydra_context, config, task_function

    def launch(self, job_overrides, initial_job_idx):
        from hydra.core.singleton import Singleton

        runs = enumerate(map(list, job_overrides), initial_job_idx)
        state = Singleton.get_state()
        return Parallel(2)(delayed(start)(*run, *self.given, state) for run in runs)
"""
"""A launcher that runs the runs of a sweep in other processes, as hydra-joblib-launcher does."""


def test_a_launcher_may_start_the_runs_of_a_sweep_in_other_processes(tmp_path: Path) -> None:
    package = tmp_path / "hydra_plugins" / "elsewhere"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "launcher.py").write_text(LAUNCHER)
    own = tmp_path / "own" / "hydra" / "launcher"
    own.mkdir(parents=True)
    (own / "elsewhere.yaml").write_text("_target_: hydra_plugins.elsewhere.launcher.Elsewhere\n")
    options = ["size=2x3,chess,3x2", "labyrinths=1", "random_steps=5", "stages=build"]
    launched = ["--config-dir", "own", "-m", "hydra/launcher=elsewhere"]
    env = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{RUN.parent}"}
    command = [sys.executable, str(RUN), *launched, *options, "data_dir=1.10"]
    done = ended(command, cwd=tmp_path, env=env)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert done.stderr.count("error: size=chess: ") == 1
    made = {path.name for path in (tmp_path / "1.10").iterdir()}
    assert made >= {"2x3", "3x2"}


def test_hydra_is_given_the_objective_of_each_run_of_a_sweep(tmp_path: Path) -> None:
    (tmp_path / "shows.py").write_text(
        "from hydra.experimental.callback import Callback\n"
        "class Objective(Callback):\n"
        "    def on_job_end(self, config, job_return, **_):\n"
        "        print('objective', job_return.return_value)\n"
    )
    shows = "defaults: [config, _self_]\nhydra: {callbacks: {shows: {_target_: shows.Objective}}}"
    (tmp_path / "mine.yaml").write_text(shows)
    stage = "return run.dataset.seed / 4 if run.dataset.seed else None"
    named = ["--config-dir", ".", "--config-name", "mine"]
    done = run_with(tmp_path, stage, *named, "-m", "seed=0,1,3", "stages=build")
    assert (done.returncode, done.stderr) == (0, "")
    shown = [line for line in done.stdout.splitlines() if line.startswith("objective")]
    assert shown == ["objective None", "objective 0.25", "objective 0.75"]


def test_what_was_made_lies_beside_the_options_that_make_it_again(
    tmp_path: Path, small_dataset: Run
) -> None:
    data = f"data_dir={small_dataset.data_dir}"
    method = ["method=bc", "method.epochs=1", "threads=1", "train_labyrinths=3"]
    method += ["encoder=mlp", "observation=vector"]
    texts = ["evaluation.name=true", r"evaluation.budget='1.10 \${x}'"]
    first = run(tmp_path, "size=3", data, *method, "stages=train", *texts)
    assert (first.returncode, first.stderr) == (0, "")
    made = content_of(tmp_path)
    folder = "runs/3x3/bc-mlp-seed0-labyrinths3"
    assert f"  {Job.CONFIG}\n" in made[f"{folder}/SHA256SUMS"].decode()
    again = tmp_path / "again"
    again.mkdir()
    done = run(again, "--config-dir", f"../{folder}", "--config-name", "config")
    assert (done.returncode, done.stderr) == (0, "")
    repeated = content_of(again)
    assert repeated.keys() == made.keys()
    for name in (f"{folder}/{Job.CONFIG}", f"{folder}/model.safetensors"):
        assert repeated[name] == made[name]


def test_what_a_user_asks_hydra_to_keep_of_a_sweep_is_kept(tmp_path: Path) -> None:
    options = ["size=2x3", "labyrinths=1,2", "data_dir=data/${labyrinths}", "stages=build"]
    given = ["hydra.sweep.dir=kept", "hydra.output_subdir=of_hydra"]
    assert run(tmp_path, "-m", *options, *given).returncode == 0
    for number in ("0", "1"):
        kept = (tmp_path / "kept" / number / "of_hydra" / "overrides.yaml").read_text()
        assert f"labyrinths={int(number) + 1}" in kept


@pytest.mark.parametrize("name", ["resolve", "options_of", "as_given", "next_command"])
def test_a_bug_in_the_handling_of_options_gets_its_traceback(tmp_path: Path, name: str) -> None:
    program = f"""
import sys
from pipeline import __main__
from pipeline.command import launch

def planted(*_, **__):
    len(5)

launch.{name} = planted
sys.exit(__main__.main())
"""
    arguments = ["size=2x3", "labyrinths=1", "stages=build"]
    environment = {"PYTHONPATH": str(RUN.parent)}
    done = ended([python(), "-c", program, *arguments], env=environment, cwd=tmp_path)
    assert done.returncode == 1
    assert "error:" not in done.stderr
    assert done.stderr.endswith("TypeError: object of type 'int' has no len()\n")


@pytest.mark.parametrize("text", ["size: [5", 'size: "\x01"', "size: 5\nsize: 4", "size: 'a"])
def test_a_broken_file_of_options_is_answered_with_its_name_in_one_line(
    tmp_path: Path, text: str
) -> None:
    (tmp_path / "mine.yaml").write_text(text)
    error = refused("--config-dir", str(tmp_path), "--config-name", "mine")
    assert re.search(r'in ".*/mine.yaml", (line|position) \d', error)


def test_a_run_says_what_it_made_in_few_lines(tmp_path: Path) -> None:
    *lines, last = run(tmp_path, "size=3", "workers=2").stdout.splitlines()
    assert len(lines) < 24
    assert all(len(line) <= 80 for line in lines)
    assert lines[-7:] == [
        "To load it: load_dataset('data/labyrinth', '3x3')",
        "data/labyrinth/3x3 is valid: 4,052 rows replayed.",
        "Leakage: no structure is in two splits, and none is repeated.",
        "Mirrored with start and goal kept: none.",
        "Turned: 15 of validation and 12 of test in train; 10 of test in validation.",
        "Wrote data/labyrinth/3x3/analysis.json (near-duplicates, tests of shift).",
        "data/labyrinth/README.md describes 3x3.",
    ]
    assert last.startswith("Next, to look at it in a browser: python ")


OF_A_DATASET = {
    "analyse": [],
    "validate": [],
    "card": [],
    "publish": ["publish.repo_id=a/b", "publish.version=1.0.0"],
    "report": [],
    "export": ["export.format=minari"],
}
"""Stages that need a finished dataset -> their options."""


@pytest.mark.parametrize("stage", [stage for stage in OF_A_DATASET if stage in STAGES])
def test_a_stage_that_is_asked_about_a_dataset_that_is_not_there_says_so(
    small_dataset: Run, stage: str
) -> None:
    options = [f"stages={stage}", *OF_A_DATASET[stage], f"data_dir={small_dataset.data_dir}"]
    for named in (["size=4"], ["size=3", "task=icy_floor"]):
        assert "holds no" in refused(*named, *options)
