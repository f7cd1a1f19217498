"""Policies that are ONNX graphs: they are computed as written, and hostile ones are refused."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from seasons import Performer
from support.graphs import elsewhere, endless, linear, node, tensor

from labyrinth_core import evaluate
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import PolicyError
from labyrinth_core.policies import graph
from labyrinth_core.policies.graph import GraphPolicy
from labyrinth_core.policies.graph_process import ASKED
from pipeline.season.judge import fetched

pytestmark = pytest.mark.slow

GRAPH, MOST_BYTES = "model.onnx", 1 << 28

WEIGHTS = np.random.default_rng(0).normal(size=(64 * 64 * 3, 4)).astype(np.float32)
PICTURES = np.random.default_rng(1).integers(256, size=(9, 64, 64, 3)).astype(np.uint8)
FAR = tensor("far", np.array([200_000, 50_000, 4]))
NOTHING = tensor("nothing", np.zeros(4, np.float32))

more = partial(linear, WEIGHTS, scores="scores")


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_a_graph_is_computed_as_it_is_written(tmp_path, dtype, small_dataset):
    (tmp_path / GRAPH).write_bytes(linear(WEIGHTS, dtype))
    with fetched(str(tmp_path)) as submission:
        assert (submission.policy.observation, submission.policy.image_size) == ("image", 64)
        scores = submission.policy(PICTURES)
        right = PICTURES.reshape(9, -1).astype(np.float32) @ WEIGHTS
        np.testing.assert_allclose(scores, right, atol=0.5)
        if dtype == "uint8":
            played = partial(evaluate, submission.policy, small_dataset.data_dir, "3x3")
            again = [played(splits=["test"]) for _ in range(2)]
            moves = [each.splits["test"].episodes.moves.tolist() for each in again]
            assert moves[0] == moves[1]


def test_a_graph_may_look_at_vectors():
    weights = np.eye(7, 4, dtype=np.float32)
    with GraphPolicy(linear(weights, "int32", ("batch", 7)), "vectors") as policy:
        assert (policy.observation, policy.image_size) == ("vector", None)
        with pytest.raises(PolicyError, match="have 7 numbers, those of these labyrinths 9"):
            policy(np.zeros((2, 9), np.int32))
        assert policy(np.arange(14).reshape(2, 7)).tolist() == [[0, 1, 2, 3], [7, 8, 9, 10]]


@pytest.mark.parametrize("shape", [("b", "n"), ("", ""), ("b", 7)])
def test_vectors_may_have_any_length_that_the_graph_declares(shape):
    weights = np.eye(7, 4, dtype=np.float32)
    with GraphPolicy(linear(weights, "int32", shape), "vectors") as policy:
        assert policy(np.arange(14).reshape(2, 7)).tolist() == [[0, 1, 2, 3], [7, 8, 9, 10]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"no graph", "INVALID_PROTOBUF"),
        (more(nodes=[node("Steal", ["product"], "scores", "evil")]), "No opset import for domain"),
        (more(nodes=[node("Steal", ["product"], "scores")]), "No Op registered for Steal"),
        (linear(WEIGHTS, shape=("batch", 64, 48, 4)), "its input is tensor.uint8. of shape"),
        (linear(WEIGHTS, shape=(1, 64, 64, 3)), "its input is tensor.uint8. of shape"),
        (linear(np.ones((12288, 5), np.float32)), "its output is tensor.float. of shape"),
        (
            more(
                nodes=[node("Add", ["product", "weights_2"], "scores")],
                tensors=[elsewhere("weights_2", [4], "secret.bin")],
            ),
            r"its weights are in another file, but one file is needed: export it with torch\.onnx\."
            r"export\(\.\.\., external_data=False\)$",
        ),
        (
            more(nodes=[node("Div", ["nothing", "nothing"], "scores")], tensors=[NOTHING]),
            r"its output is tensor.float. of shape \[\]",
        ),
        (
            more(
                nodes=[
                    node("Div", ["nothing", "nothing"], "nan"),
                    node("Add", ["product", "nan"], "scores"),
                ],
                tensors=[NOTHING],
            ),
            "the policy answered nan as the score of an action",
        ),
        (
            more(
                nodes=[
                    node("Expand", ["nothing", "far"], "large"),
                    node("ReduceMax", ["large"], "most", keepdims=0),
                    node("Add", ["product", "most"], "scores"),
                ],
                tensors=[NOTHING, FAR],
            ),
            "Failed to allocate memory|its process ended, perhaps because memory ran out",
        ),
    ],
    ids=[
        *("no graph", "another domain", "unknown operator", "other pictures", "a fixed batch"),
        *("five actions", "data elsewhere", "other scores", "nan", "much memory"),
    ],
)
def test_a_hostile_graph_is_refused_in_one_line(content, message, small_dataset):
    with (
        pytest.raises(PolicyError, match=message) as refused,
        GraphPolicy(content, "evil.onnx") as policy,
    ):
        evaluate(policy, small_dataset.data_dir, "3x3", splits=["test"])
    assert "\n" not in str(refused.value)
    assert refused.value.__cause__ is None


def test_a_graph_that_does_not_end_is_refused_in_time(monkeypatch):
    monkeypatch.setattr(graph, "SECONDS", 1.5)
    with (
        pytest.raises(PolicyError, match=r"it takes more than 1\.5 seconds$"),
        GraphPolicy(endless(), "evil.onnx") as policy,
    ):
        policy(PICTURES)


def test_the_process_of_a_graph_has_a_limit_of_its_own_on_processor_time():
    batch = PICTURES[:1].tobytes()
    limited = (
        "import sys; from labyrinth_core.policies import graph_process as g; g.SECONDS = 1; "
        "g.serve(sys.stdin.buffer, sys.stdout.buffer)"
    )
    for content, status in ((linear(WEIGHTS), 0), (endless(), -signal.SIGXCPU)):
        asked = ASKED.pack(len(content), 0) + content + ASKED.pack(len(batch), 1) + batch
        ended = subprocess.run(
            [sys.executable, "-c", limited], input=asked, capture_output=True, check=False
        )
        assert ended.returncode == status


def test_a_graph_that_draws_at_random_is_refused_in_words_that_fit_a_judge(
    hidden, tmp_path, make_run
):
    drawn = node("RandomUniformLike", ["product"], "scores")
    (tmp_path / GRAPH).write_bytes(more(nodes=[drawn]))
    perform = Performer(tmp_path, make_run)
    shutil.copytree(hidden.place.public.parent, perform.place.public.parent)
    said = perform("judge", submission=str(tmp_path / GRAPH))
    assert "the policy answers the same observations differently: a season judges only" in said


def test_a_large_graph_and_what_is_no_graph_are_refused_before_they_are_read(tmp_path):
    large = tmp_path / GRAPH
    large.touch()
    with large.open("r+b") as file:
        file.truncate(MOST_BYTES + 1)
    for given, message in (
        (large, f"has {MOST_BYTES + 1:,} bytes, more than {MOST_BYTES:,}"),
        (tmp_path, "more than"),
        (tmp_path / "missing", "is neither a folder, a file, nor an id"),
    ):
        with pytest.raises(DatasetError, match=message), fetched(str(given)):
            pass
    large.unlink()
    with pytest.raises(DatasetError, match="holds no policy: give model"):
        fetched(str(tmp_path)).__enter__()
