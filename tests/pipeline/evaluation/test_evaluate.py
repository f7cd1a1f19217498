"""The stage `evaluate`: what it writes and prints of a trained run, and which runs it refuses."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from support.making import perform
from support.remembering import known_routes

from labyrinth_core import Dataset, PolicyError, evaluate, load_arrays, load_episodes, load_policy
from labyrinth_core.data import SPLITS, Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import KnownDataset, Player, Results
from pipeline.config import ConfigError
from pipeline.training import train

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run_of(make_run):
    """A function that returns a run of both stages with one epoch of training."""

    def of(data_dir, run_dir, **options):
        usual = {"stages": ["train", "evaluate"], "method": {"name": "bc", "epochs": 1}}
        return make_run(data_dir, run_dir=str(run_dir), device="cpu", **usual | options)

    return of


@pytest.fixture(scope="module")
def trained(small_dataset, run_of, tmp_path_factory):
    """A run that was trained."""
    run = run_of(small_dataset.data_dir, tmp_path_factory.mktemp("runs"))
    train.run(run)
    return run


@pytest.fixture
def elsewhere(trained, run_of):
    """A function that returns the trained run with another dataset, or judged on another one."""

    def of(data_dir, **options):
        return run_of(data_dir, trained.options.run_dir, stages=["evaluate"], **options)

    return of


def test_the_stage_writes_what_the_policy_achieves_and_prints_it(trained, capsys):
    perform("evaluate", trained)
    printed = capsys.readouterr().out
    assert all(split in printed for split in SPLITS.evaluated)
    folder = trained.training_folder
    text = (folder / "results.json").read_text(encoding="utf-8")
    content = json.loads(text)
    assert list(content["splits"]) == list(content["baselines"]["fixed_path"])
    assert list(content["splits"]) == list(SPLITS.evaluated)
    assert content["run"]["fingerprint"] == content["dataset"]["fingerprint"]
    assert content["run"]["seed"] == content["evaluated"]["seed"] == 0
    assert set(content["splits"]["train"]["known_route"]) == {"1"}
    assert content["baselines"]["route_memory"]["train"]["spl"] == 1
    known = KnownDataset.read(str(trained.data_dir), "3x3")
    results = Results.load(folder / "results.json", lambda _: known)
    results.require_dataset(known)
    assert results.run.name == folder.name == results.method.name == "bc-cnn-seed0"
    policy = load_policy(folder)
    for split in SPLITS.evaluated:
        arrays = load_arrays(trained.data_dir, "3x3", split)
        assert content["splits"][split]["sr"] == Player.of(policy).success_rate(arrays)
    perform("evaluate", trained)
    assert (folder / "results.json").read_text(encoding="utf-8") == text


def test_a_run_that_is_not_there_or_of_another_dataset_is_refused(
    trained, elsewhere, build, tmp_path
):
    with pytest.raises(DatasetError, match=r"seed7 holds no finished run: stages=train"):
        perform("evaluate", elsewhere(trained.data_dir, seed=7))
    other = build(tmp_path, labyrinths=2)
    with pytest.raises(DatasetError, match=r"on another dataset than .*; policy=.* evaluates it"):
        perform("evaluate", elsewhere(other.data_dir))


def test_a_run_that_was_trained_with_another_setting_is_refused(trained, elsewhere):
    asked = elsewhere(trained.options.data_dir, method={"name": "bc", "epochs": 5})
    with pytest.raises(DatasetError, match=r"was trained with method.epochs=1, not 5: leave the"):
        perform("evaluate", asked)
    perform("evaluate", elsewhere(trained.options.data_dir, method={"name": "bc"}))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"seed": 2}, "seed=0, not 2"),
        ({"protocol": "paper"}, "protocol=default, not paper"),
        ({"train_labyrinths": 5}, "train_labyrinths=None, not 5"),
        ({"encoder": "resnet18"}, "encoder=cnn, not resnet18"),
        ({"method": {"name": "gail"}}, "method=bc, not gail"),
        ({"size": "4"}, "config=3x3, not 4x4"),
    ],
)
def test_a_run_under_the_name_of_another_is_not_judged_as_that_run(
    trained, run_of, tmp_path, options, told
):
    run = run_of(trained.data_dir, tmp_path, **options)
    shutil.copytree(trained.training_folder, run.training_folder)
    with pytest.raises(DatasetError, match=f"was trained with {told}: move it elsewhere, or"):
        perform("evaluate", run)


def test_a_run_whose_dataset_has_moved_is_the_same_run(trained, run_of, tmp_path, capsys):
    shutil.copytree(trained.options.run_dir, tmp_path / "runs")
    run = run_of(shutil.copytree(trained.data_dir, tmp_path / "moved"), tmp_path / "runs")
    perform("evaluate", run)
    train.run(run)
    assert "is complete already" in capsys.readouterr().out
    (run.training_folder / "model.safetensors").unlink()
    train.run(run)
    perform("evaluate", run)


def test_every_change_of_a_record_is_damage(trained, run_of, tmp_path):
    shutil.copytree(trained.options.run_dir, tmp_path / "runs")
    run = run_of(trained.data_dir, tmp_path / "runs")
    path = run.training_folder / "run.json"
    text = path.read_text(encoding="utf-8")
    for old, new in (
        ('"epochs": 1', '"epochs": 7'),
        ('"seconds"', '"second"'),
        ("{", ""),
        ("1", "2"),
    ):
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        for read in (lambda: perform("evaluate", run), lambda: load_policy(run.training_folder)):
            with pytest.raises(DatasetError, match=r"run.json is damaged: .* SHA256SUMS") as caught:
                read()
            assert str(caught.value).endswith("; stages=train overwrite=true makes it again")
    with pytest.raises(DatasetError, match=r"run.json, damaged or changed .*: give overwrite=true"):
        train.run(run)
    train.run(run_of(trained.data_dir, tmp_path / "runs", overwrite=True))
    perform("evaluate", run)


def test_damaged_results_of_a_run_are_written_anew_as_the_message_says(trained, run_of, tmp_path):
    shutil.copytree(trained.options.run_dir, tmp_path / "runs")
    run = run_of(trained.data_dir, tmp_path / "runs")
    perform("evaluate", run)
    path = run.training_folder / "results.json"
    right = path.read_bytes()
    path.write_bytes(right.replace(b'"seed": 0', b'"seed": 1'))
    with pytest.raises(DatasetError, match=r"results.json: .* or give overwrite=true$"):
        perform("evaluate", run)
    perform("evaluate", run_of(trained.data_dir, tmp_path / "runs", overwrite=True))
    assert path.read_bytes() == right


def test_a_home_folder_is_named_in_files_as_it_was_typed(trained, run_of, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    shutil.copytree(trained.data_dir, tmp_path / "lab")
    for number, options in enumerate(
        ({"data_dir": "~/lab/"}, {"data_dir": "x", "dataset": "~/lab"})
    ):
        run = run_of(options.pop("data_dir"), tmp_path / "runs" / str(number), **options)
        train.run(run)
        perform("evaluate", run)
        for path in run.training_folder.iterdir():
            assert bytes(tmp_path) not in path.read_bytes(), path
        results = Results.load(run.training_folder / "results.json")
        assert results.dataset == results.run.dataset == "~/lab"


def test_a_policy_that_differs_from_its_record_is_refused(trained, run_of, tmp_path):
    shutil.copytree(trained.options.run_dir, tmp_path / "runs")
    run = run_of(trained.data_dir, tmp_path / "runs")
    path = run.training_folder / "model.safetensors"
    weights = bytearray(path.read_bytes())
    weights[-1] ^= 1
    path.write_bytes(weights)
    damaged = "model.safetensors is damaged: its sha256 is not the one in run.json"
    with pytest.raises(DatasetError, match=damaged):
        perform("evaluate", run)
    with pytest.raises(DatasetError, match="the one in SHA256SUMS; download or train it again"):
        load_policy(run.training_folder)
    path.unlink()
    with pytest.raises(DatasetError, match="does not exist: stages=train makes it"):
        perform("evaluate", run)


def test_a_dataset_that_grows_during_an_evaluation_or_before_training_ends_it(
    build, run_of, tmp_path
):
    small = build(tmp_path / "data", labyrinths=2)
    grown = build(tmp_path / "grown", labyrinths=3)

    def grow(seen=()):
        shutil.rmtree(small.folder)
        shutil.copytree(grown.folder, small.folder)
        return np.zeros(len(seen), np.int64)

    with pytest.raises(DatasetError, match="grew while it was read: run this again"):
        evaluate(grow, small.data_dir, "3x3")

    shutil.rmtree(small.folder)
    small = build(tmp_path / "data", labyrinths=2)
    run = run_of(small.data_dir, tmp_path / "runs")
    identity = train.identify(run, {}, Manifest.read(small.folder).fingerprint)
    data = Dataset.at(small.folder)
    grow()
    with pytest.raises(DatasetError, match="grew while it was read: run this again"):
        train._train(run, data, tmp_path, tmp_path / "checkpoint", identity, 30)


def test_another_dataset_is_evaluated_beside_the_one_that_was_trained_on(
    trained, elsewhere, build, tmp_path, datasets
):
    perform("evaluate", trained)
    folder = trained.training_folder
    before = (folder / "results.json").read_bytes()
    policy = load_policy(folder)
    build(tmp_path, labyrinths=2, seed=5)
    for data_dir, name in ((tmp_path, "3x3"), (datasets, "3x4-icy_floor")):
        # The dataset that it was trained on need not be there.
        perform("evaluate", elsewhere(tmp_path / "gone", evaluate_on=f"{data_dir}/{name}/"))
        (path,) = folder.glob(f"results-{name}-*.json")
        content = json.loads(path.read_bytes())
        fingerprint = Manifest.read(data_dir / name).fingerprint
        assert path.stem == f"results-{name}-{fingerprint[:8]}"
        assert content["dataset"]["fingerprint"] == fingerprint
        assert (content["dataset"]["config"], content["run"]["config"]) == (name, "3x3")
        for split in SPLITS.evaluated:
            arrays = load_arrays(data_dir, name, split)
            assert content["splits"][split]["sr"] == Player.of(policy).success_rate(arrays)
    assert (folder / "results.json").read_bytes() == before


def test_the_folder_of_a_run_is_the_run_on_its_own_dataset_and_on_another_one(
    trained, elsewhere, run_of, build, tmp_path
):
    """`policy=RUN` gives what the options of the run give: the same file, references and seed."""
    folder = trained.training_folder
    for path in folder.glob("results*.json"):
        path.unlink()
    perform("evaluate", trained)
    longer = build(tmp_path, labyrinths=3 * trained.dataset.labyrinths)
    where = f"{longer.data_dir}/{longer.dataset.name}"
    perform("evaluate", elsewhere(trained.data_dir, evaluate_on=where))
    files = {path: path.read_bytes() for path in folder.glob("results*.json")}
    assert len(files) == 2
    for data_dir in (trained.data_dir, longer.data_dir):
        for path in files:
            path.unlink(missing_ok=True)
        perform("evaluate", run_of(data_dir, tmp_path, stages=["evaluate"], policy=str(folder)))
        (path,) = folder.glob("results*.json")
        assert path.read_bytes() == files[path]


def test_in_more_labyrinths_the_references_know_what_the_policy_learnt_from(
    trained, elsewhere, build, tmp_path
):
    longer = build(tmp_path, labyrinths=3 * trained.dataset.labyrinths)
    fingerprint = Manifest.read(longer.folder).fingerprint

    def evaluated(data_dir):
        perform(
            "evaluate", elsewhere(data_dir, evaluate_on=f"{longer.data_dir}/{longer.dataset.name}")
        )
        name = f"results-{longer.dataset.name}-{fingerprint:.8}.json"
        return json.loads((trained.training_folder / name).read_bytes())

    found = evaluated(trained.data_dir)
    train = load_episodes(trained.data_dir, "3x3", split="train", observation="vector")
    known = known_routes(train, load_arrays(longer.data_dir, "3x3", "test").labyrinths)
    assert found["splits"]["test"]["known_route"] == "".join(str(int(each)) for each in known)
    assert found["run"]["references_know"] == found["run"]["fingerprint"]
    gone = evaluated(tmp_path / "gone")
    assert gone["run"]["references_know"] is None
    assert gone["splits"]["train"]["sr_known_route"] == gone["splits"]["train"]["sr"]
    assert found["splits"]["train"]["known_route"] != gone["splits"]["train"]["known_route"]


def test_a_policy_that_cannot_see_another_dataset_says_so_in_one_line(
    small_dataset, run_of, make_run, tmp_path, datasets
):
    vectors = {"encoder": "mlp", "observation": "vector"}
    train.run(run_of(small_dataset.data_dir, tmp_path, **vectors))
    for name, error, message in (
        ("3x4", PolicyError, r"the policy needs vectors of 3x3, .* those of 3x4, .*"),
        ("9x9", DatasetError, "config=9x9: .*"),
    ):
        run = run_of(small_dataset.data_dir, tmp_path, **vectors, evaluate_on=f"{datasets}/{name}")
        with pytest.raises(error, match=rf"\A{message}\Z"):
            perform("evaluate", run)
    with pytest.raises(ConfigError, match=r"\Aevaluate_on=9x9: give a dataset and its config"):
        run_of(small_dataset.data_dir, tmp_path, evaluate_on="9x9")
    with pytest.raises(ConfigError, match=r"\Aevaluate_on=d/3x3 is for trained policies"):
        make_run(tmp_path, stages=["evaluate"], policy="module:name", evaluate_on="d/3x3")


def test_after_training_on_some_labyrinths_they_alone_are_those_of_train(
    small_dataset, run_of, tmp_path
):
    run = run_of(small_dataset.data_dir, tmp_path / "runs", train_labyrinths=3)
    train.run(run)
    perform("evaluate", run)
    content = json.loads((run.training_folder / "results.json").read_text(encoding="utf-8"))
    assert content["run"]["train_labyrinths"] == 3
    counts = {split: content["splits"][split]["labyrinths"] for split in SPLITS.evaluated}
    assert counts == {"train": 3, "validation": 8, "test": 8, "s0": 3, "s0_and_g": 3}
    results = Results.load(run.training_folder / "results.json")
    assert results.run.of_all_seeds == "bc-cnn-labyrinths3"
