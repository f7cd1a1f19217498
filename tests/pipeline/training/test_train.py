"""The stage `train`: reproducible weights, interruptions, and what a run leaves."""

from __future__ import annotations

import json
import re
import shutil
import socket
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from support.learning import method_of
from support.making import Run, perform

from labyrinth_core.data import Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import PolicyError, Results
from labyrinth_core.learning import PolicySpec
from labyrinth_core.pictures import observations
from labyrinth_core.policies import RunRecord
from pipeline.config import ConfigError
from pipeline.machinery import Sums
from pipeline.training import train

pytestmark = pytest.mark.slow

BC = method_of("bc")
CURVES = "curves.png"
BOARD, CHECKPOINT = "tensorboard", "checkpoint.safetensors"


@pytest.fixture
def run_of(small_dataset: Run, make_run: Callable[..., Run], tmp_path: Path) -> Callable[..., Run]:
    """A function that returns a run of the stage on the small dataset, three epochs of BC."""

    def make(folder: str = "runs", **options: Any) -> Run:
        settings = {"name": "bc", "epochs": 3, "evaluate_every": 2} | options.pop("method", {})
        data_dir = options.pop("data_dir", small_dataset.data_dir)
        given = {"stages": ["train"], "run_dir": str(tmp_path / folder), "method": settings}
        return make_run(data_dir, **given | options)

    return make


def weights_of(run: Run) -> bytes:
    return (run.training_folder / PolicySpec.WEIGHTS).read_bytes()


def record_of(run: Run) -> dict[str, Any]:
    record: dict[str, Any] = json.loads((run.training_folder / RunRecord.FILE).read_text())
    return record


def test_a_run_leaves_policy_curves_a_record_and_the_randomness_of_others_as_it_was(
    run_of: Callable[..., Run], capsys: pytest.CaptureFixture[str]
) -> None:
    run = run_of()
    before = torch.get_rng_state()
    train.run(run)
    assert torch.equal(torch.get_rng_state(), before)
    folder = run.training_folder
    assert folder.name == "bc-cnn-seed0"
    assert sorted(path.name for path in folder.iterdir()) == [
        Sums.FILE,
        PolicySpec.FILE,
        CURVES,
        PolicySpec.WEIGHTS,
        RunRecord.FILE,
    ]
    record = record_of(run)
    assert record["run"]["settings"]["epochs"] == 3
    assert len(record["run"]["fingerprint"]) == 64
    assert [row["epoch"] for row in record["history"]] == [1, 2, 3]
    assert ["validation_sr" in row for row in record["history"]] == [False, True, True]
    assert record["selected"] in record["history"]
    assert "SR" in capsys.readouterr().out


def test_a_run_returns_its_success_rate_on_validation_which_a_sweep_may_maximise(
    run_of: Callable[..., Run],
) -> None:
    run = run_of()
    made, there_already = train.run(run), train.run(run)
    assert made == there_already == record_of(run)["selected"]["validation_sr"]


def results_of(run: Run) -> Results:
    """Evaluate a run, and return its results."""
    perform("evaluate", run)
    return Results.load(run.training_folder / Results.FILE)


def test_a_run_does_not_depend_on_what_another_library_sets_in_torch(
    run_of: Callable[..., Run],
) -> None:
    runs = run_of("usual"), run_of("other")
    train.run(runs[0])
    torch.set_default_dtype(torch.float64)
    torch.set_default_device("meta")
    try:
        train.run(runs[1])
        assert results_of(runs[1]).way == "look-ups"
    finally:
        torch.set_default_device(None)
        torch.set_default_dtype(torch.float32)
    assert weights_of(runs[0]) == weights_of(runs[1])


def test_a_run_killed_after_any_epoch_ends_as_if_it_had_not_been(
    run_of: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = run_of("whole")
    train.run(whole)
    killed, epoch = run_of("killed"), BC.epoch
    for survived in (1, 1):
        left = [survived]

        def dying(self: Any, left: list[int] = left) -> dict[str, float]:
            if not left.pop():
                raise KeyboardInterrupt
            left.append(0)
            return epoch(self)

        monkeypatch.setattr(BC, "epoch", dying)
        with pytest.raises(KeyboardInterrupt):
            train.run(killed, checkpoint_seconds=0)
        (working,) = killed.training_folder.parent.iterdir()
        assert [path.name for path in working.iterdir()] == [CHECKPOINT]
    done: list[Any] = []

    def counted(self: Any) -> dict[str, float]:
        done.append(self)
        return epoch(self)

    monkeypatch.setattr(BC, "epoch", counted)
    train.run(killed)
    assert len(done) == len(record_of(whole)["history"]) - 2  # What was done is not done again.
    assert weights_of(killed) == weights_of(whole)
    histories = [record_of(run) for run in (whole, killed)]
    for history in histories:
        for row in [*history["history"], history["selected"]]:
            del row["seconds"]
    assert histories[0]["history"] == histories[1]["history"]
    assert histories[0]["selected"] == histories[1]["selected"]


def test_a_finished_run_is_not_done_again_unless_its_policy_is_gone_and_not_replaced(
    run_of: Callable[..., Run], capsys: pytest.CaptureFixture[str]
) -> None:
    run = run_of()
    train.run(run)
    before = {path: path.stat().st_mtime_ns for path in run.training_folder.iterdir()}
    train.run(run)
    assert "complete already" in capsys.readouterr().out
    changed = {"method": {"epochs": 4}}
    with pytest.raises(DatasetError, match="overwrite=true") as caught:
        train.run(run_of(**changed))
    assert "is made with method.epochs=3, not 4: choose" in str(caught.value)
    assert {path: path.stat().st_mtime_ns for path in run.training_folder.iterdir()} == before
    weights = weights_of(run)
    (run.training_folder / CURVES).unlink()
    train.run(run)
    assert "complete already" in capsys.readouterr().out  # No policy is trained for a picture.
    (run.training_folder / PolicySpec.WEIGHTS).unlink()
    train.run(run)
    assert "made again, because missing: model.safetensors" in capsys.readouterr().out
    assert weights_of(run) == weights
    (run.training_folder / PolicySpec.WEIGHTS).write_bytes(weights + b"?")
    with pytest.raises(
        DatasetError, match=f"{PolicySpec.WEIGHTS}, damaged or changed .*: give over"
    ):
        train.run(run)
    assert weights_of(run) == weights + b"?"
    train.run(run_of(overwrite=True))
    assert weights_of(run) == weights
    train.run(run_of(**changed, overwrite=True))
    assert record_of(run)["epochs"] == 4


def test_overwriting_a_run_keeps_what_is_not_of_it(run_of: Callable[..., Run]) -> None:
    run = run_of()
    folder = run.training_folder
    folder.mkdir(parents=True)
    (folder / PolicySpec.WEIGHTS).write_text("mine")
    with pytest.raises(
        DatasetError, match=f"holds {PolicySpec.WEIGHTS}, which would be lost: move it"
    ):
        train.run(run)
    (folder / PolicySpec.WEIGHTS).unlink()
    train.run(run)
    for name in ("notes.txt", CHECKPOINT):
        (folder / name).write_text("mine")
    train.run(run_of(overwrite=True))
    for name in ("notes.txt", CHECKPOINT):
        assert (folder / name).read_text() == "mine"
    for name in (CURVES, "results.json"):
        (folder / name).write_bytes(b"mine")
        with pytest.raises(DatasetError, match=f"holds {name}, which would be lost: move it"):
            train.run(run_of(overwrite=True))
        assert (folder / name).read_bytes() == b"mine"
        (folder / name).unlink()


def test_the_labyrinths_of_test_are_never_opened(
    run_of: Callable[..., Run], small_dataset: Run, tmp_path: Path
) -> None:
    copy = tmp_path / "labyrinth"
    shutil.copytree(small_dataset.data_dir, copy)
    for split in ("test", "s0", "s0_and_g"):
        for shard in copy.glob(f"3x3/{split}-*"):
            shard.unlink()
    without, with_them = run_of("without", data_dir=str(copy)), run_of("with")
    for run in (without, with_them):
        train.run(run)
    assert weights_of(without) == weights_of(with_them)


def test_the_curves_are_written_for_tensorboard_on_request(run_of: Callable[..., Run]) -> None:
    run = run_of(tensorboard=True)
    train.run(run)
    events = list((run.training_folder / BOARD).iterdir())
    assert len(events) == 1
    assert re.fullmatch(r"events\.out\.tfevents\.\d+", events[0].name)  # No name of a computer.
    assert socket.gethostname().encode() not in events[0].read_bytes()
    assert b"validation_sr" in events[0].read_bytes()


def test_a_missing_library_is_answered_with_the_extra_that_has_it(
    run_of: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(ConfigError, match=r"pip install 'labyrinth-datasets\[tensorboard\]'"):
        train.run(run_of(tensorboard=True))
    monkeypatch.setattr("pipeline.config.options.find_spec", lambda _: None)
    with pytest.raises(ConfigError, match=r"torch: pip install 'labyrinth-datasets\[train\]'"):
        run_of().options.check_training()


def test_no_dataset_is_answered_with_the_command_that_makes_it(
    run_of: Callable[..., Run], tmp_path: Path
) -> None:
    command = r"labyrinth-datasets size=3x3 task=navigation data_dir=\S+"
    with pytest.raises(DatasetError, match=command):
        train.run(run_of(data_dir=str(tmp_path / "nothing")))
    assert not (tmp_path / "runs").exists()


def test_no_random_policy_to_learn_from_is_answered_in_one_line(
    run_of: Callable[..., Run], small_dataset: Run, tmp_path: Path
) -> None:
    copy = tmp_path / "labyrinth"
    shutil.copytree(small_dataset.data_dir, copy)
    manifest = Manifest.read(copy / "3x3")
    shards = tuple(shard for shard in manifest.shards if shard.split != "random")
    replace(manifest, shards=shards).write(copy / "3x3")
    with pytest.raises(DatasetError, match=r"^method=bco learns from the split random of"):
        train.run(run_of(data_dir=str(copy), method={"name": "bco"}))
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"method": {"epochs": 0}}, "method.epochs=0: give a whole number, 1 or more"),
        ({"method": {"learning_rate": "x"}}, "method.learning_rate=x: give a number"),
        ({"method": {"speed": 1}}, "method.speed is not an option: choose from [method.epochs"),
        ({"method": {"name": "sqil", "gamma": 1}}, "method.gamma=1: give a number from 0 to 0.999"),
        ({"method": {"name": "sqil", "temperature": 0}}, "give a number, 0.001 or more"),
        (
            {"method": {"name": "planner", "channels": 0}},
            "channels=0: give a whole number from 1 to",
        ),
        (
            {"method": {"name": "planner", "path_prior": 1}},
            "method.path_prior=1: give true or false",
        ),
        (
            {"method": {"name": "planner", "path_prior": False, "iterations": 251}},
            "method.iterations is 251: without path_prior, channels=32 and average=true allow at",
        ),
        (
            {"method": {"name": "planner", "sharpness": 1001}},
            "sharpness=1001: give a number from 0",
        ),
        ({"method": {"name": "mapper", "looks": 65}}, "looks=65: give a whole number from 1 to 64"),
        ({"revision": "v1"}, "is a folder, which has no revisions"),
        ({"train_labyrinths": 9}, "train_labyrinths=9: give 8 or fewer, as many as train of /"),
        ({"train_labyrinths": 0}, "train_labyrinths=0: give a whole number, 1 or more"),
    ],
)
def test_an_impossible_setting_is_refused_in_one_line(
    run_of: Callable[..., Run], tmp_path: Path, options: dict[str, Any], told: str
) -> None:
    with pytest.raises((ConfigError, PolicyError)) as caught:
        train.run(run_of(**options))
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "runs").exists()


def test_a_device_that_is_not_there_is_refused(
    run_of: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.accelerator, "is_available", lambda: False)
    with pytest.raises(ConfigError, match="device=cuda: no such device is available"):
        train.run(run_of(device="cuda"))


@pytest.mark.parametrize("found", ["cuda", "xpu", "mps"])
def test_auto_takes_the_accelerator_that_pytorch_finds(
    run_of: Callable[..., Run], monkeypatch: pytest.MonkeyPatch, found: str
) -> None:
    monkeypatch.setattr(torch.accelerator, "is_available", lambda: True)
    monkeypatch.setattr(torch.accelerator, "current_accelerator", lambda: torch.device(found))
    assert train.choose_device(run_of(device="auto").options).type == found
    assert train.choose_device(run_of(device="cpu").options).type == "cpu"
    if found != "cuda":
        with pytest.raises(ConfigError, match="device=cuda: no such device is available"):
            train.choose_device(run_of(device="cuda").options)


def test_the_record_says_what_may_be_rounded_to_tf32_on_nvidias_gpus_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", False)
    found = train.computed_on(torch.device("cuda"))
    assert found["tf32"] == {"convolutions": False, "products": False}
    assert train.computed_on(torch.device("cpu")).keys() == {"device", "threads"}


# Some of the labyrinths of train.


def test_a_run_on_the_first_labyrinths_is_one_on_a_dataset_that_has_no_others(
    run_of: Callable[..., Run], build: Callable[..., Run], tmp_path: Path
) -> None:
    # BCO learns from demonstrations and from random steps.
    settings = {"method": {"name": "bco"}, "observation": "vector", "encoder": "mlp"}
    few = build(tmp_path / "few", labyrinths=5)
    # Validation is that of the few, too, and the policy selected on it.
    small = {"data_dir": str(few.data_dir), "labyrinths": 5}
    first, whole = run_of("a", train_labyrinths=3, **small, **settings), run_of("b", **settings)
    fewer = build(tmp_path / "fewer", labyrinths=3)
    own = run_of("c", data_dir=str(fewer.data_dir), labyrinths=3, **settings)
    for run in (first, whole, own):
        train.run(run)
    histories = [[row["loss"] for row in record_of(run)["history"]] for run in (first, own, whole)]
    assert histories[0] == histories[1] != histories[2]
    assert first.training_folder.name == "bco-mlp-seed0-labyrinths3"
    assert record_of(first)["run"]["train_labyrinths"] == 3


# Many labyrinths.


@pytest.mark.parametrize("observation", ["image", "vector"])
def test_a_run_whose_pictures_do_not_fit_into_memory_ends_as_one_that_holds_them(
    observation: str, run_of: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = {"observation": observation, "encoder": {"image": "cnn", "vector": "mlp"}[observation]}
    held, drawn = run_of("held", **seen), run_of("drawn", **seen)
    train.run(held)
    monkeypatch.setattr(observations, "HELD_BYTES", 0)
    train.run(drawn)
    assert weights_of(held) == weights_of(drawn)
    rates = [[row.get("train_sr") for row in record_of(run)["history"]] for run in (held, drawn)]
    assert rates[0] == rates[1]
    judged = [results_of(run).splits for run in (held, drawn)]
    for split, scores in judged[0].items():
        assert scores.figures() == judged[1][split].figures()


def test_evaluations_during_training_play_the_first_labyrinths_of_many(
    run_of: Callable[..., Run], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def rates(run: Run) -> list[float]:
        return [
            row[f"{split}_sr"]
            for row in record_of(run)["history"]
            if "train_sr" in row
            for split in ("train", "validation")
        ]

    most = run_of("all")
    train.run(most)
    assert "Evaluations during training" not in capsys.readouterr().out
    monkeypatch.setattr(train, "TRIED", 3)
    few = run_of("few", method={"evaluate_every": 1})
    train.run(few)
    said = "Evaluations during training play the first 3 labyrinths of train and validation."
    assert said in " ".join(capsys.readouterr().out.split())
    assert len(rates(few)) == 6
    assert {round(3 * rate, 6) % 1 for rate in rates(few)} == {0}
    losses = [[row["loss"] for row in record_of(run)["history"]] for run in (most, few)]
    assert losses[0] == losses[1]
