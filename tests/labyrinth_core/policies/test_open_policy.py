"""`open_policy` opens each kind of name, pins it, and says in one line what it cannot open."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.policies import lay_out_run

from labyrinth_core import DatasetError, load_policy, open_policy
from labyrinth_core.learning import NetworkSpec, PolicySpec
from labyrinth_core.policies import PolicyNameError
from labyrinth_core.storage import File

MLP = PolicySpec(NetworkSpec("mlp", 3, 3, "navigation"), average=False)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return lay_out_run(tmp_path / "run", MLP, seed=3)


def test_a_run_says_how_it_was_trained_and_what_its_files_are(run: Path) -> None:
    policy = open_policy(run)
    assert (policy.run.name, policy.run.seed) == ("bc-mlp-seed3", 3)
    weights = File(run / "model.safetensors").sha256()
    assert policy.run.evaluated["weights"] == weights
    assert (policy.origin.source, policy.origin.commit) == (str(run), None)
    files = {name: File(run / name).sha256() for name in ("model.safetensors", "config.json")}
    assert policy.origin.files == files
    assert open_policy(f"{run}@{weights}").origin.files == files


def test_a_run_of_an_earlier_version_is_refused_with_what_to_do(run: Path) -> None:
    (run / "model.safetensors").rename(run / "policy.safetensors")
    (run / "config.json").unlink()
    record = (run / "run.json").read_text(encoding="utf-8")
    (run / "run.json").write_text(record.replace('"format": 2', '"format": 1'), encoding="utf-8")
    told = "it.format is 1, not 2; stages=train overwrite=true makes it again"
    for load in (open_policy, load_policy):
        with pytest.raises(DatasetError, match=rf"run.json cannot be read: {told}\Z"):
            load(run)


def test_the_run_of_a_method_in_python_may_have_other_rules_than_its_network(
    tmp_path: Path,
) -> None:
    assert open_policy(lay_out_run(tmp_path / "run", MLP, method="mine:Method")).run is None


def test_what_cannot_be_opened_is_told_in_one_line(run: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "policy.pkl").touch()
    for name, kind, told in (
        (
            f"{run}@1.0.0",
            PolicyNameError,
            f"{run} is a folder, which has no revisions: @ and the S",
        ),
        (
            f"{run}@{'0' * 64}",
            DatasetError,
            f"{run}: model.safetensors differs from the named rev",
        ),
        (
            tmp_path / "empty",
            DatasetError,
            f"{tmp_path}/empty holds no policy: give model.safetens",
        ),
        (
            tmp_path / "policy.pkl",
            DatasetError,
            f"{tmp_path}/policy.pkl is neither a folder nor an",
        ),
        (
            "absent",
            DatasetError,
            "absent is neither a folder, a file, nor an id such as user/planne",
        ),
        ("json:absent", PolicyNameError, "there is no absent, only ["),
        ("absent_module:make", PolicyNameError, "there is no module absent_module, neither in /"),
    ):
        with pytest.raises(kind, match=rf"\A{re.escape(told)}") as refused:
            open_policy(name)
        assert "\n" not in str(refused.value)
    with pytest.raises(PolicyNameError, match=r"json:load: a policy in Python is not executed"):
        open_policy("json:load", code=False)
