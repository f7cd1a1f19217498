"""`results.replay=true`: policies play again, and files that claim other episodes are refused."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from support.graphs import linear
from support.making import RunConfig, perform
from support.policies import lay_out_run
from support.submitted import forgetful, results_of

from labyrinth_core import Dataset, evaluate, open_policy
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Description, Evaluation
from labyrinth_core.learning import NetworkSpec, PolicySpec

MLP = PolicySpec(NetworkSpec("mlp", 3, 3, "navigation"), average=False)


NEAR_TIE = (
    "; there the scores of two actions differ by only 0e+00 of the greatest, so another machine "
    "may decide otherwise"
)


@pytest.fixture(scope="module")
def data(small_dataset):
    return Dataset(str(small_dataset.data_dir), "3x3")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """The folder of the policies."""
    return tmp_path_factory.mktemp("policies")


@pytest.fixture(scope="module")
def kinds(data, place):
    """The results of a run and of a policy in a folder, as the stage `evaluate` leaves them."""
    torch.set_num_threads(1)
    about = {"fingerprint": data.fingerprint, "dataset": str(data.source)}
    run = open_policy(lay_out_run(place / "runs" / "3x3" / "bc-mlp-seed0", MLP, **about))
    policy = open_policy(lay_out_run(place / "policy", MLP))
    return {
        "run": Evaluation.of(run, data, run=run.run).results(),
        "folder": evaluate(policy, data, splits=["test"]),
    }


@pytest.fixture(scope="module")
def and_a_graph(kinds, data, place):
    """The same, and those of an ONNX graph."""
    weights = np.random.default_rng(0).normal(size=(28, 4)).astype(np.float32)
    (place / "mine.onnx").write_bytes(linear(weights, "int32", ("batch", 28)))
    with open_policy(place / "mine.onnx") as graph:
        return kinds | {"graph": evaluate(graph, data, splits=["test"])}


@pytest.fixture
def rank(make_run, small_dataset, place, tmp_path):
    """A function that keeps results, runs the stage, and returns the board and what is refused."""

    def run(replay=True, **results):
        folder = tmp_path / "results"
        for name, each in results.items():
            under = "submissions" if each.run is None else "runs/3x3"
            shown = name if each.run is None else each.run.name
            each.save(folder / under / f"{shown}.json", name=shown)
        job = make_run(
            small_dataset.data_dir,
            stages=["results"],
            run_dir=str(place / "runs"),
            results_dir=str(folder),
            results=replace(RunConfig().results, replay=replay),
        )
        refused = ""
        try:
            perform("results", job)
        except DatasetError as error:
            refused = str(error)
        text = (folder / "leaderboard.md").read_text(encoding="utf-8")
        rows = re.findall(r"^\|[^|]*\| ([^|]+) \|.*\| ([^|]+) \|$", text.split("On all")[0], re.M)
        return dict(rows[2:]), refused

    run.folder = tmp_path / "results"
    return run


def forged(results, other):
    """Return the results of another policy's play under the name and the hashes of a policy."""
    splits = {split: other.splits[split] for split in results.splits}
    return replace(results, splits=splits)


@pytest.mark.slow  # It starts the process of a graph.
def test_an_honest_board_is_replayed_and_says_so(and_a_graph, rank):
    kinds = and_a_graph
    board, refused = rank(**kinds)
    assert not refused
    played = {"BC, mlp" if name == "run" else name: "replayed" for name in kinds}
    computed = dict.fromkeys(("random steps", "route memory"), "computed")
    assert board == played | computed
    board, _ = rank(replay=False)
    assert board == dict.fromkeys(played, "organiser's word") | computed


@pytest.mark.slow  # It starts the process of a graph.
def test_the_play_of_another_policy_under_a_name_is_refused_by_replay_and_marked_without(
    and_a_graph, rank, small_dataset
):
    kinds = and_a_graph
    other = results_of(small_dataset.data_dir, "3x3", forgetful(3, 3))
    files = {name: forged(results, other) for name, results in kinds.items()}
    board, _ = rank(replay=False, **files)
    assert {board["BC, mlp"], board["folder"]} == {"organiser's word"}
    board, refused = rank()
    assert set(board.values()) <= {"computed"}
    lines = refused.splitlines()[1:]
    assert len(lines) == len(files)
    told = r"labyrinth [0-9a-f]{16} is \w+ after \d+ moves, but \w+ after \d+ when the policy plays"
    assert all(re.search(rf"\.json is refused: \w+: {told} it", line) for line in lines), refused


def test_other_files_than_those_that_are_named_are_refused(kinds, rank):
    files = kinds["folder"].policy.files | {"run.json": "0" * 64}
    _, refused = rank(
        a=replace(kinds["folder"], policy=replace(kinds["folder"].policy, files=files))
    )
    assert "it.policy names run.json with the SHA-256 0000000000000000, but " in refused
    settings = {"average": True}
    _, refused = rank(b=replace(kinds["run"], run=replace(kinds["run"].run, settings=settings)))
    assert "it.run.settings is {'average': True}, but {'average': False} in the run" in refused


@pytest.mark.parametrize(("deviation", "why"), [(1.0, ""), (0.0, NEAR_TIE)])
def test_a_file_without_hashes_that_is_named_after_a_policy_is_played_as_that_policy(
    rank, place, small_dataset, deviation, why
):
    policy = lay_out_run(place / f"named{deviation}", MLP, deviation)
    other = replace(results_of(small_dataset.data_dir, "3x3", forgetful(3, 3)), policy=None)
    content = other.to_text(Description(str(policy)))
    path = rank.folder / "submissions" / "a.json"
    path.parent.mkdir(parents=True)
    path.write_text(content, encoding="utf-8")
    _, refused = rank()
    assert refused.endswith(f"when the policy plays it{why}")


def test_a_file_cannot_name_code_that_is_executed(kinds, rank, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    Path("evil.py").write_text("raise SystemExit('executed')", encoding="utf-8")
    named = replace(kinds["folder"].policy, source="evil:policy")
    board, refused = rank(a=replace(kinds["folder"], policy=named))
    assert (board["a"], refused) == ("organiser's word", "")
    assert "evil:policy: a policy in Python is not executed" in capsys.readouterr().out
