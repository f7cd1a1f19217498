"""A run that replaces a finished one, and what happens if it is killed or fails on the way."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from support.crashing import killed_before
from support.learning import method_of
from support.making import Run

from labyrinth_core.errors import DatasetError
from labyrinth_core.learning import PolicySpec
from labyrinth_core.policies import RunRecord
from labyrinth_core.storage import File
from pipeline.config import ConfigError
from pipeline.machinery import Sums, leave
from pipeline.training import record, train

pytestmark = pytest.mark.slow

BC = method_of("bc")
CURVES = "curves.png"


@pytest.fixture
def run_of(small_dataset: Run, make_run: Callable[..., Run], tmp_path: Path) -> Callable[..., Run]:
    """A function that returns a run of two epochs of BC on vectors."""

    def make(**method: Any) -> Run:
        return make_run(
            small_dataset.data_dir,
            stages=["train"],
            run_dir=str(tmp_path / "runs"),
            overwrite=True,
            observation="vector",
            encoder="mlp",
            method={"name": "bc", "epochs": 2} | method,
        )

    return make


def require_finished(folder: Path) -> int:
    """Fail unless a folder holds a whole run; return the number of its epochs."""
    content = json.loads((folder / RunRecord.FILE).read_bytes())
    assert {name: File(folder / name).sha256() for name in content["files"]} == content["files"]
    assert PolicySpec.WEIGHTS in content["files"]
    return int(content["epochs"])


def test_missing_curves_are_drawn_again_and_changed_ones_are_named(
    run_of: Callable[..., Run], capsys: pytest.CaptureFixture[str]
) -> None:
    run = replace(run_of(), options=replace(run_of().options, overwrite=False))
    train.run(run)
    path = run.training_folder / CURVES
    drawn = path.read_bytes()
    path.unlink()
    train.run(run)
    assert path.read_bytes() == drawn
    require_finished(path.parent)
    path.write_bytes(b"mine")
    train.run(run)
    assert path.read_bytes() == b"mine"
    printed = " ".join(capsys.readouterr().out.split())
    assert f"{path} was missing, and is drawn again." in printed
    assert f"{path} was damaged or changed: delete it to have it drawn again." in printed
    (path.parent / PolicySpec.WEIGHTS).write_bytes(b"damaged")
    with pytest.raises(
        DatasetError, match=f"holds {PolicySpec.WEIGHTS}, damaged or changed since it was made"
    ):
        train.run(run)


def test_a_kill_before_any_change_of_files_leaves_the_old_run_or_the_new_one(
    run_of: Callable[..., Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record, "_curves", lambda *_: b"drawn")  # Drawing takes most of the time.
    folder, old = run_of().training_folder, tmp_path / "old"
    train.run(run_of(epochs=1))
    (folder / "notes.txt").write_text("mine")
    leave(folder, {"results.json": b"of this policy"})
    folder.rename(old)
    moments, displaced = 0, 0
    while True:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(old, folder)
        retrain = partial(train.run, run_of(), checkpoint_seconds=0)
        if not killed_before(moments, folder.parent, retrain):
            break
        found = folder if folder.exists() else next(folder.parent.glob("*.replaced"))
        displaced += found != folder
        assert require_finished(found) in (1, 2)
        moments += 1
        train.run(run_of())
        assert require_finished(folder) == 2
        assert [path.name for path in folder.parent.iterdir()] == [folder.name]
        there = sorted(path.name for path in folder.iterdir())
        assert there == [
            Sums.FILE,
            PolicySpec.FILE,
            CURVES,
            PolicySpec.WEIGHTS,
            "notes.txt",
            RunRecord.FILE,
        ]
    assert moments > 15
    assert displaced == 1  # Between the two renames, from which the next run recovers.


def test_a_killed_run_that_replaces_another_goes_on_unless_settings_change(
    run_of: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    train.run(run_of(epochs=1))
    epoch, done = BC.epoch, []

    def dying(self: Any) -> dict[str, float]:
        if done:
            raise KeyboardInterrupt
        done.append(1)
        return epoch(self)

    def counted(self: Any) -> dict[str, float]:
        done.append(1)
        return epoch(self)

    for settings, still_to_do in (({}, 1), ({"epochs": 3}, 3)):
        monkeypatch.setattr(BC, "epoch", dying)
        with pytest.raises(KeyboardInterrupt):
            train.run(run_of(), checkpoint_seconds=0)
        monkeypatch.setattr(BC, "epoch", counted)
        done.clear()
        train.run(run_of(**settings))
        assert len(done) == still_to_do
        done.clear()


def test_a_training_that_fails_leaves_the_finished_run_and_stops_no_other(
    run_of: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = run_of(epochs=1)
    train.run(run)
    before = {path.name: path.read_bytes() for path in run.training_folder.iterdir()}
    with monkeypatch.context() as patch:
        patch.setattr(BC, "epoch", lambda _: {"loss": float("nan")})
        with pytest.raises(ConfigError, match="Existing files are unchanged"):
            train.run(run_of())
    assert {path.name: path.read_bytes() for path in run.training_folder.iterdir()} == before
    assert [path.name for path in run.training_folder.parent.iterdir()] == ["bc-mlp-seed0"]
    train.run(run_of())
    assert require_finished(run.training_folder) == 2


def test_curves_that_cannot_be_drawn_cost_no_policy(
    run_of: Callable[..., Run],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = run_of()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    train.run(run)
    assert "curves.png is left out, because it cannot be drawn: " in capsys.readouterr().out
    assert require_finished(run.training_folder) == 2
    assert not (run.training_folder / CURVES).exists()
    monkeypatch.undo()
    train.run(run)
    assert (run.training_folder / CURVES).exists()


def test_what_a_notebook_draws_with_does_not_matter() -> None:
    program = (
        "from pipeline.training.record import _curves\n"
        "assert _curves('bc', [{'epoch': 1, 'loss': 0.5}]).startswith(b'\\x89PNG')"
    )
    for backend in ("module://no_such.backend", "no_such"):
        # A quick Python has imported Matplotlib, which reads this when it is imported.
        command, environment = [sys.executable, "-c", program], os.environ | {"MPLBACKEND": backend}
        subprocess.run(command, env=environment, check=True)
