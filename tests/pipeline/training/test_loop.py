"""The loop of all methods: where training cannot go on, and its precision."""

from __future__ import annotations

import json
from collections.abc import Callable
from math import inf, isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from learning import settings_of

from labyrinth_core.data.errors import DatasetError
from pipeline.config.errors import ConfigError
from pipeline.config.run import Run
from pipeline.config.training import PROTOCOLS
from pipeline.training import train
from pipeline.training.loop import fit
from pipeline.training.methods import bc
from pipeline.training.methods.method import Problem, find
from pipeline.training.policy import require_same
from pipeline.training.record import CHECKPOINT


@pytest.mark.slow
@pytest.mark.parametrize("broken", [nan, inf])
def test_a_loss_that_is_not_finite_ends_the_run_and_leaves_the_checkpoint_before_it(
    problem_of: Callable[..., Problem], tmp_path: Path, broken: float
) -> None:
    learner = bc.Method(problem_of(), settings_of("bc", epochs=9))
    path, losses, kept = tmp_path / CHECKPOINT, iter([2.0, 1.0, broken]), []

    def epoch() -> dict[str, float]:
        if path.exists():
            kept.append(path.read_bytes())
        return {"loss": next(losses)}

    learner.__class__ = type("Broken", (bc.Method,), {"epoch": lambda _: epoch()})
    with pytest.raises(ConfigError) as caught:
        fit(
            learner,
            lambda _: {"validation_sr": 0.5},
            PROTOCOLS["default"],
            path,
            {"run": 1},
            lambda _: None,
            checkpoint_seconds=0,
        )
    assert f"method.learning_rate=0.0005: loss is {broken} in epoch 3, " in str(caught.value)
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == kept[-1]


@pytest.mark.slow
def test_the_protocol_of_the_paper_stops_after_five_evaluations_without_a_better_one(
    problem_of: Callable[..., Problem], tmp_path: Path
) -> None:
    learner = bc.Method(problem_of(), settings_of("bc", epochs=100))
    learner.__class__ = type("Idle", (bc.Method,), {"epoch": lambda _: {"loss": 0.5}})
    rates = iter([0.1, *[0.3] * 10])

    def judge(_: Any) -> dict[str, float]:
        return {"validation_sr": next(rates)}

    done = fit(learner, judge, PROTOCOLS["paper"], tmp_path / CHECKPOINT, {}, lambda _: None)
    assert done.epoch == 70
    assert done.best is not None
    assert done.best["epoch"] == 70


# Precision.


def bf16_learner(problem_of: Callable[..., Problem], **settings: Any) -> bc.Method:
    problem = problem_of(encoder="cnn", precision="bf16")
    return bc.Method(problem, settings_of("bc", batch_size=8, **settings))


@pytest.mark.slow
def test_in_bf16_weights_and_gradients_stay_float32_and_the_policy_learns(
    problem_of: Callable[..., Problem], tmp_path: Path
) -> None:
    learner = bf16_learner(problem_of, epochs=12, learning_rate=2e-3)
    shown, picture = set(), learner.problem.observations[:1].numpy()
    learner.policy.classifier[-1].register_forward_hook(
        lambda layer, _, output: shown.add((layer.training, output.dtype))
    )

    def judge(policy: Any) -> dict[str, float]:
        policy(picture)
        return {"validation_sr": 0.5}

    path = tmp_path / CHECKPOINT
    done = fit(learner, judge, PROTOCOLS["default"], path, {}, lambda _: None)
    assert shown == {(True, torch.bfloat16), (False, torch.float32)}
    kinds = {(each.dtype, each.grad.dtype) for each in learner.policy.parameters()}
    assert kinds == {(torch.float32, torch.float32)}
    assert done.history[-1]["loss"] < done.history[0]["loss"] / 2
    assert {each.dtype for each in done.weights.values()} == {torch.float32, torch.int64}


@pytest.mark.slow
def test_in_bf16_each_step_is_taken_with_the_weights_after_the_one_before(
    problem_of: Callable[..., Problem],
) -> None:
    learner = bf16_learner(problem_of)
    picture = learner.see(learner.problem.arrays.initial[:1])
    with learner.problem.autocast():
        learner.policy.train(False)
        before = learner.policy(picture)
        with torch.no_grad():
            learner.policy.classifier[-1].weight.mul_(2)
            learner.policy.classifier[-1].bias.mul_(2)
        assert torch.allclose(learner.policy(picture), 2 * before)


@pytest.mark.slow
def test_in_the_usual_precision_nothing_is_computed_in_bf16(
    problem_of: Callable[..., Problem], tmp_path: Path
) -> None:
    learner, shown = bc.Method(problem_of(encoder="cnn"), settings_of("bc", epochs=1)), set()
    for layer in learner.policy.modules():
        layer.register_forward_hook(lambda *of: shown.add(of[-1].dtype))
    path = tmp_path / CHECKPOINT
    fit(learner, lambda _: {"validation_sr": 0.5}, PROTOCOLS["default"], path, {}, lambda _: None)
    assert shown == {torch.float32}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dagger", "gail", "bco", "sqil", "iupe"])
def test_every_method_can_be_trained_in_bf16(problem_of: Callable[..., Problem], name: str) -> None:
    method, settings = find(name, {"batch_size": 64})
    learner = method(problem_of(precision="bf16"), settings)
    for _ in range(2):
        with learner.problem.autocast():
            assert all(isfinite(value) for value in learner.epoch().values())


@pytest.mark.slow
def test_the_precision_is_part_of_what_a_run_is(
    small_dataset: Run, make_run: Callable[..., Run], tmp_path: Path
) -> None:
    def run_of(**options: Any) -> Run:
        usual = {"stages": ["train"], "run_dir": str(tmp_path), "method": {"name": "bc"}}
        return make_run(small_dataset.data_dir, **usual, **options)

    settings = settings_of("bc")
    plain, half = (train.identify(run_of(**each), settings) for each in ({}, {"precision": "bf16"}))
    assert (plain["precision"], half) == ("fp32", plain | {"precision": "bf16"})
    assert run_of(precision="bf16").training_folder.name == "bc-cnn-seed0-bf16"
    with pytest.raises(DatasetError, match="precision=bf16, not fp32"):
        require_same("a run", half, plain)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("returned", "state", "told"),
    [
        ({"reward": 1.0}, 0, r"epoch returned \{'reward': 1\.0\}: it has to return numbers by"),
        (None, 0, "epoch returned None: "),
        (0.5, 0, r"epoch returned 0\.5: "),
        ({"loss": "much"}, 0, "epoch returned .'loss': 'much'.: "),
        ({"loss": torch.ones(2)}, 0, r"epoch returned \{'loss': tensor\("),
        ({"loss": 0.5}, [], "attribute seen is of the type list, which a checkpoint does not keep"),
    ],
)
def test_what_a_method_may_not_do_is_refused_at_once(
    problem_of: Callable[..., Problem], tmp_path: Path, returned: Any, state: Any, told: str
) -> None:
    learner, epochs = bc.Method(problem_of(), settings_of("bc")), []

    def epoch(learner: Any) -> Any:
        epochs.append(1)
        learner.seen = state
        return returned

    learner.__class__ = type("Wrong", (bc.Method,), {"epoch": epoch})
    judge, protocol = (lambda _: {"validation_sr": 0.5}), PROTOCOLS["default"]
    with pytest.raises(ConfigError, match=told) as caught:
        fit(learner, judge, protocol, tmp_path / CHECKPOINT, {}, lambda _: None)
    assert "\n" not in str(caught.value)
    assert epochs == [1]


@pytest.mark.slow
def test_figures_of_numpy_and_torch_are_kept_as_numbers(
    problem_of: Callable[..., Problem], tmp_path: Path
) -> None:
    learner = bc.Method(problem_of(), settings_of("bc", epochs=1))
    figures = {"loss": np.float32(0.5), "steps": np.int64(3), "norm": torch.tensor(0.25)}
    learner.__class__ = type("Foreign", (bc.Method,), {"epoch": lambda _: figures})
    judge, protocol = (lambda _: {"validation_sr": 0.5}), PROTOCOLS["default"]
    done = fit(learner, judge, protocol, tmp_path / CHECKPOINT, {}, lambda _: None)
    assert (
        json.loads(json.dumps(done.history[0])).items()
        >= {"loss": 0.5, "steps": 3.0, "norm": 0.25}.items()
    )
