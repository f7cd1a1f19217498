"""The stage `evaluate`: what it writes and prints of a trained run, and which runs it refuses."""

from __future__ import annotations

import json

import pytest
from policies import Remembering

from labyrinth_core import evaluate
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.evaluation.baselines import TrainMemory
from labyrinth_core.evaluation.known import KnownDataset
from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
from labyrinth_core.evaluation.playing import success_rate
from labyrinth_core.evaluation.replanner import Replanner
from labyrinth_core.evaluation.results import Results
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS
from pipeline.config.errors import ConfigError
from pipeline.evaluation import evaluate as stage
from pipeline.report.findings import read_results
from pipeline.studies.results import results
from pipeline.training import train
from pipeline.training.methods import bc
from pipeline.training.methods.method import find
from pipeline.training.policy import read_policy

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def trained(small_dataset, make_run, tmp_path_factory):
    """A run that was trained for an epoch."""
    run = make_run(
        small_dataset.data_dir,
        stages=["train", "evaluate"],
        run_dir=str(tmp_path_factory.mktemp("runs")),
        device="cpu",
        method={"name": "bc", "epochs": 1},
    )
    train.run(run)
    return run


def test_the_stage_writes_what_the_policy_achieves_and_prints_it(trained, capsys):
    stage.run(trained)
    printed = capsys.readouterr().out
    assert all(split in printed for split in EVALUATED_SPLITS)
    folder = trained.training_folder
    text = (folder / "results.json").read_text(encoding="utf-8")
    content = json.loads(text)
    assert list(content["splits"]) == list(content["baselines"]["fixed_path"])
    assert list(content["splits"]) == list(EVALUATED_SPLITS)
    assert content["run"]["fingerprint"] == content["dataset"]["fingerprint"]
    assert content["run"]["seed"] == content["evaluated"]["seed"] == 0
    assert set(content["splits"]["train"]["known_route"]) == {"1"}
    assert content["baselines"]["route_memory"]["train"]["spl"] == 1
    known = KnownDataset.read(str(trained.data_dir), "3x3")
    results = Results.load(folder / "results.json", lambda _: known)
    results.require_dataset(known)
    assert results.run.name == folder.name == results.method.name == "bc-cnn-seed0"
    policy = read_policy(folder / "policy.safetensors", train.spec_of(trained))
    for split in EVALUATED_SPLITS:
        arrays = load_arrays(trained.data_dir, "3x3", split)
        assert content["splits"][split]["sr"] == success_rate(policy, arrays)
    stage.run(trained)
    assert (folder / "results.json").read_text(encoding="utf-8") == text


def test_a_policy_that_remembers_is_stepped_in_training_and_in_evaluation(
    trained, small_dataset, make_run, tmp_path, monkeypatch
):
    stage.run(trained)
    run = make_run(
        small_dataset.data_dir,
        stages=["train", "evaluate"],
        run_dir=str(tmp_path),
        device="cpu",
        method={"name": "bc", "epochs": 1},
    )
    counts = []

    def player(policy, spec, settings):
        assert (spec.height, spec.width, settings.epochs) == (3, 3, 1)
        remembering = Remembering(policy)
        remembering.counts = counts
        return remembering

    monkeypatch.setattr(bc.Method, "player", player)
    train.run(run)
    assert counts == [8, 8]  # Train and validation, after the only epoch.
    stage.run(run)
    assert counts[2:] == [8] * len(EVALUATED_SPLITS)
    records, evaluations = (
        [json.loads((each.training_folder / name).read_bytes()) for each in (trained, run)]
        for name in ("run.json", "results.json")
    )
    del records[0]["history"][0]["seconds"], records[1]["history"][0]["seconds"]
    assert records[0]["history"] == records[1]["history"]
    Results.load(run.training_folder / "results.json")
    for split in EVALUATED_SPLITS:
        looked_up, stepped = (each["splits"][split] for each in evaluations)
        for name in ("accuracy_on_demonstrations", "accuracy_elsewhere"):
            assert stepped.pop(name) is None
            del looked_up[name]
        assert stepped == looked_up


def test_a_run_that_is_not_there_or_of_another_dataset_is_refused(
    trained, build, make_run, tmp_path
):
    options = {"stages": ["evaluate"], "run_dir": trained.options.run_dir, "device": "cpu"}
    with pytest.raises(DatasetError, match=r"seed7 holds no finished run: stages=train"):
        stage.run(make_run(trained.data_dir, seed=7, **options))
    other = build(tmp_path, labyrinths=2)
    with pytest.raises(DatasetError, match=r"was trained on another dataset than .* evaluate_on="):
        stage.run(make_run(other.data_dir, **options))


def test_another_dataset_is_evaluated_beside_the_one_that_was_trained_on(
    trained, build, make_run, tmp_path, datasets
):
    stage.run(trained)
    folder = trained.training_folder
    before = (folder / "results.json").read_bytes()
    policy = read_policy(folder / "policy.safetensors", train.spec_of(trained))
    build(tmp_path, labyrinths=2, seed=5)
    for data_dir, name in ((tmp_path, "3x3"), (datasets, "3x4"), (datasets, "3x4-icy_floor")):
        options = {"stages": ["evaluate"], "run_dir": trained.options.run_dir, "device": "cpu"}
        # The dataset that it was trained on need not be there.
        run = make_run(tmp_path / "gone", **options, evaluate_on=f"{data_dir}/{name}")
        stage.run(run)
        (path,) = folder.glob(f"results-{name}-*.json")
        content = json.loads(path.read_bytes())
        fingerprint = Manifest.read(data_dir / name).fingerprint
        assert path.stem == f"results-{name}-{fingerprint[:8]}"
        assert content["dataset"]["fingerprint"] == fingerprint
        assert (content["dataset"]["config"], content["run"]["config"]) == (name, "3x3")
        for split in EVALUATED_SPLITS:
            arrays = load_arrays(data_dir, name, split)
            assert content["splits"][split]["sr"] == success_rate(policy, arrays)
    assert (folder / "results.json").read_bytes() == before


def test_in_more_labyrinths_the_references_know_what_the_policy_learnt_from(
    trained, build, make_run, tmp_path
):
    longer = build(tmp_path, labyrinths=3 * trained.dataset.labyrinths)
    options = {"stages": ["evaluate"], "run_dir": trained.options.run_dir, "device": "cpu"}
    evaluate_on = f"{longer.data_dir}/{longer.dataset.name}"

    def evaluated(data_dir):
        stage.run(make_run(data_dir, **options, evaluate_on=evaluate_on))
        fingerprint = Manifest.read(longer.data_dir / longer.dataset.name).fingerprint
        name = f"results-{longer.dataset.name}-{fingerprint:.8}.json"
        return json.loads((trained.training_folder / name).read_bytes())

    found = evaluated(trained.data_dir)
    memory = TrainMemory.of(load_arrays(trained.data_dir, "3x3", "train"))
    known, _ = memory.figures(load_arrays(longer.data_dir, "3x3", "test"))
    assert found["splits"]["test"]["known_route"] == "".join(map(str, known.astype(int)))
    assert found["run"]["references_know"] == found["run"]["fingerprint"]
    gone = evaluated(tmp_path / "gone")
    assert gone["run"]["references_know"] is None
    assert gone["splits"]["train"]["sr_known_route"] == gone["splits"]["train"]["sr"]
    assert found["splits"]["train"]["known_route"] != gone["splits"]["train"]["known_route"]


def test_a_policy_that_cannot_see_another_dataset_says_so_in_one_line(
    small_dataset, make_run, tmp_path, datasets
):
    options = {"stages": ["train"], "run_dir": str(tmp_path), "device": "cpu"}
    options |= {"encoder": "mlp", "observation": "vector", "method": {"name": "bc", "epochs": 1}}
    train.run(make_run(small_dataset.data_dir, **options))
    run = make_run(small_dataset.data_dir, **options, evaluate_on=f"{datasets}/3x4")
    with pytest.raises(ConfigError, match=r"\Aevaluate_on=.*/3x4: .* at 3x4 than at 3x3, .*\Z"):
        stage.run(run)
    run = make_run(small_dataset.data_dir, **options, evaluate_on=f"{datasets}/9x9")
    with pytest.raises(DatasetError, match=r"\Aconfig=9x9: .*\Z"):
        stage.run(run)
    with pytest.raises(ConfigError, match=r"\Aevaluate_on=9x9: give a dataset and its config"):
        make_run(small_dataset.data_dir, **options, evaluate_on="9x9")
    with pytest.raises(ConfigError, match=r"\Aevaluate_on=d/3x3 is for policies of runs"):
        make_run(tmp_path, stages=["evaluate"], policy="module:name", evaluate_on="d/3x3")


def test_under_partial_observability_the_replanner_stands_beside_the_policy(
    datasets, make_run, tmp_path, capsys
):
    run = make_run(
        datasets,
        size="3x4",
        task="partial_observability",
        stages=["train", "evaluate"],
        run_dir=str(tmp_path),
        device="cpu",
        method={"name": "bc", "epochs": 1},
    )
    train.run(run)
    stage.run(run)
    content = json.loads((run.training_folder / "results.json").read_bytes())
    own = evaluate(Replanner(3, 4), datasets, run.dataset.name, observation="vector")
    assert content["baselines"]["replanner"]["test"] == own.splits["test"].summary()
    assert "without" in capsys.readouterr().out


@pytest.mark.parametrize("method", ["bc", "planner"])
def test_a_run_with_memory_is_another_run_and_is_stepped(build, make_run, tmp_path, method):
    build(tmp_path, task="partial_observability")
    options = {"task": "partial_observability", "run_dir": str(tmp_path / "runs")}
    options |= {"stages": ["train", "evaluate", "results"], "device": "cpu"}
    options |= {"results_dir": str(tmp_path / "results")}
    options |= {"method": {"name": method, "epochs": 1, "pictures": 32}}
    run = make_run(tmp_path, **options, memory=True)
    train.run(run)
    stage.run(run)
    assert run.training_folder.name.endswith("-seed0-memory")
    content = json.loads((run.training_folder / "results.json").read_bytes())
    assert content["run"]["memory"] is True
    assert content["evaluated"]["way"] == "steps"
    for figures in content["splits"].values():
        assert figures["accuracy_on_demonstrations"] is figures["accuracy_elsewhere"] is None
    results.run(run)
    (kept,) = (tmp_path / "results" / "runs").rglob("*.json")
    assert Results.load(kept).run.setup == f"{run.options.network}-memory"
    without = make_run(tmp_path, **options)
    _, settings = find(method, without.options.method)
    assert "memory" not in train.identify(without, settings)
    assert without.training_folder != run.training_folder


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"task": "navigation"}, "task=navigation: choose partial_observability"),
        ({"method": {"name": "gail"}}, "method=gail: choose bc or planner"),
        ({"encoder": "mlp", "observation": "vector"}, "observation=vector: choose image"),
        ({"protocol": "paper"}, "protocol=paper: choose default"),
    ],
)
def test_what_memory_does_not_go_with_is_told_in_one_line(make_run, tmp_path, options, told):
    given = {"stages": ["train"], "task": "partial_observability", "memory": True}
    with pytest.raises(ConfigError) as caught:
        make_run(tmp_path, **given | options)
    assert str(caught.value) == f"memory=true does not go with {told}"
    with pytest.raises(ConfigError, match=r"\Amemory=true is for policies of runs; [^\n]*\Z"):
        make_run(tmp_path, **given | {"stages": ["evaluate"], "policy": "module:name"})


def test_pictures_that_are_too_small_for_a_memory_are_told_before_training(
    build, make_run, tmp_path
):
    options = {"size": "6", "task": "partial_observability"}
    build(tmp_path / "data", **options, labyrinths=1)
    options |= {"stages": ["train"], "run_dir": str(tmp_path / "runs"), "device": "cpu"}
    with pytest.raises(ConfigError, match=r"\Amemory=true: pictures of 64 pixels .* 6x6 .*\Z"):
        train.run(make_run(tmp_path / "data", **options, memory=True))
    assert not (tmp_path / "runs").exists()


def test_after_training_on_some_labyrinths_they_alone_are_those_of_train(
    small_dataset, make_run, tmp_path
):
    run = make_run(
        small_dataset.data_dir,
        stages=["train", "evaluate", "results"],
        run_dir=str(tmp_path / "runs"),
        results_dir=str(tmp_path / "results"),
        device="cpu",
        method={"name": "bc", "epochs": 1},
        train_labyrinths=3,
    )
    train.run(run)
    stage.run(run)
    content = json.loads((run.training_folder / "results.json").read_text(encoding="utf-8"))
    assert content["run"]["train_labyrinths"] == 3
    counts = {split: content["splits"][split]["labyrinths"] for split in EVALUATED_SPLITS}
    assert counts == {"train": 3, "validation": 8, "test": 8, "s0": 3, "s0_and_g": 3}
    results.run(run)
    assert "## 3x3, cnn-labyrinths3" in (tmp_path / "results" / "README.md").read_text("utf-8")
    (shown,) = read_results(
        tmp_path / "runs", small_dataset.data_dir, [Manifest.read(small_dataset.folder)]
    )
    assert shown["name"] == "bc-cnn-labyrinths3"
