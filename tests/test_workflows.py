"""The workflows of GitHub: what they run is there, and they may do no more than they have to."""

from __future__ import annotations

import os
import re
import subprocess
from itertools import chain
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
WORKFLOWS = {
    path.stem: yaml.safe_load(path.read_text(encoding="utf-8"))
    for path in (ROOT / ".github" / "workflows").iterdir()
}
JOBS = {name: job for flow in WORKFLOWS.values() for name, job in flow["jobs"].items()}
MAY_WRITE = {
    "pypi": {"id-token": "write"},
    "pages": {"id-token": "write", "pages": "write"},
    "dataset": {"contents": "read", "id-token": "write"},
}


def test_workflows_write_nowhere_but_in_the_jobs_that_publish_and_know_no_secret() -> None:
    assert all(flow["permissions"] == {"contents": "read"} for flow in WORKFLOWS.values())
    assert all(flow["concurrency"] for flow in WORKFLOWS.values())
    allowed = {name: job["permissions"] for name, job in JOBS.items() if "permissions" in job}
    assert allowed == MAY_WRITE
    assert all("environment" in JOBS[name] and "timeout-minutes" in JOBS[name] for name in allowed)
    assert "secrets" not in f"{WORKFLOWS}"


@pytest.mark.parametrize("name", JOBS)
def test_what_a_job_runs_is_there_and_takes_values_from_the_environment_alone(name: str) -> None:
    commands = [step["run"] for step in JOBS[name]["steps"] if "run" in step]
    assert not any("${{" in command for command in commands)  # A value could be a command.
    words = set(chain.from_iterable(map(str.split, commands)))
    files = {word for word in words if re.match(r"(\.ci|scripts)/|.*\.(py|txt)$", word)}
    assert [file for file in files if not (ROOT / file).is_file()] == []


def test_actions_are_pinned_to_commits() -> None:
    used = {step["uses"] for job in JOBS.values() for step in job["steps"] if "uses" in step}
    unpinned = {each for each in used if not re.fullmatch(r"[\w/-]+@[0-9a-f]{40}", each)}
    assert unpinned == {"pypa/gh-action-pypi-publish@release/v1"}  # docs/releasing.md says why.


def test_the_pythons_that_the_package_names_are_those_that_are_checked() -> None:
    lines = (ROOT / "pyproject.toml").read_text(encoding="utf-8").splitlines()
    named = {match[1] for line in lines if (match := re.search(r":: Python :: (3\.\d+)", line))}
    lanes = JOBS["fast"]["strategy"]["matrix"]["include"]
    seen = {lane["python"] for lane in lanes if not lane.get("unseen")}
    image = re.match(r"python:(3\.\d+)-", JOBS["all"]["container"]["image"])
    assert image is not None
    assert seen | {image[1]} == named


def test_what_runs_in_a_release_has_the_versions_of_constraints() -> None:
    pins = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    assert {"build", "hatchling"} <= {line.partition("==")[0] for line in pins.splitlines()}
    trusted = [JOBS[name] for name in MAY_WRITE] + [JOBS["distributions"]]
    runs = [step["run"] for job in trusted for step in job["steps"] if "run" in step]
    installed = [run for run in runs if "pip install" in run]
    assert installed
    assert all("-c constraints.txt" in run for run in installed)
    assert all("--no-build-isolation" in run for run in installed if run.split()[-1] == ".")
    assert "--no-isolation" in (ROOT / ".ci/wheel").read_text(encoding="utf-8")


def run_of_tag(tag: str, version: str, folder: Path) -> int:
    """Run the check of a tag against a version, and return its exit status."""
    (folder / "labyrinth_core").mkdir(exist_ok=True)
    (folder / "labyrinth_core" / "version.py").write_text(f'__version__ = "{version}"\n')
    (command,) = (s["run"] for s in JOBS["distributions"]["steps"] if "tag" in s.get("name", ""))
    environment = {"GITHUB_REF_NAME": tag, "PATH": os.environ["PATH"]}
    return subprocess.run(["bash", "-c", command], cwd=folder, env=environment).returncode


def test_a_tag_is_the_version_itself_and_no_pattern(tmp_path: Path) -> None:
    assert run_of_tag("v1.2.0", "1.2.0", tmp_path) == 0
    for tag in ("v1.2.1", "v1.2", "v1.*", "v...2.0", "v1x2.0"):
        assert run_of_tag(tag, "1.2.0", tmp_path) != 0
