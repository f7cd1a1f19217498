"""The loop of all methods: where it ends, where it cannot go on, and what it keeps."""

from __future__ import annotations

import json
from collections.abc import Callable
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support.learning import learner_of

from labyrinth_core.learning import Problem
from pipeline.config import ConfigError
from pipeline.training.loop import PROTOCOLS, fit


@pytest.mark.slow
@pytest.mark.parametrize("broken", [nan, inf])
def test_a_loss_that_is_not_finite_ends_the_run_and_leaves_the_checkpoint_before_it(
    problem_of: Callable[..., Problem], tmp_path: Path, broken: float
) -> None:
    learner = learner_of("bc", problem_of(), epochs=9)
    path, losses, kept = tmp_path / "checkpoint", iter([2.0, 1.0, broken]), []

    def epoch() -> dict[str, float]:
        if path.exists():
            kept.append(path.read_bytes())
        return {"loss": next(losses)}

    learner.__class__ = type("Broken", (type(learner),), {"epoch": lambda _: epoch()})
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
    learner = learner_of("bc", problem_of(), epochs=100)
    learner.__class__ = type("Idle", (type(learner),), {"epoch": lambda _: {"loss": 0.5}})
    rates = iter([0.1, *[0.3] * 10])

    def judge(_: Any) -> dict[str, float]:
        return {"validation_sr": next(rates)}

    done = fit(learner, judge, PROTOCOLS["paper"], tmp_path / "checkpoint", {}, lambda _: None)
    assert done.epoch == 70
    assert done.best is not None
    assert done.best["epoch"] == 70


@pytest.mark.slow
@pytest.mark.parametrize(
    ("returned", "state", "told"),
    [
        ({"reward": 1.0}, 0, r"epoch returned \{'reward': 1\.0\}: it has to return a dict"),
        (None, 0, "epoch returned None: "),
        (0.5, 0, r"epoch returned 0\.5: "),
        ({"loss": "much"}, 0, "epoch returned .'loss': 'much'.: "),
        ({"loss": torch.ones(2)}, 0, r"epoch returned \{'loss': tensor\("),
        *(
            ({"loss": 0.5}, value, "attribute seen has the type .*, which a checkpoint cannot save")
            for value in (["a list"], None, "a text", np.array(["a text"]), torch.ones(1))
        ),
    ],
)
def test_what_a_method_may_not_do_is_refused_at_once(
    problem_of: Callable[..., Problem], tmp_path: Path, returned: Any, state: Any, told: str
) -> None:
    learner, epochs = learner_of("bc", problem_of()), []

    def epoch(learner: Any) -> Any:
        epochs.append(1)
        learner.seen = state
        return returned

    learner.__class__ = type("Wrong", (type(learner),), {"epoch": epoch})
    judge, protocol = (lambda _: {"validation_sr": 0.5}), PROTOCOLS["default"]
    with pytest.raises(ConfigError, match=told) as caught:
        fit(learner, judge, protocol, tmp_path / "checkpoint", {}, lambda _: None)
    assert "\n" not in str(caught.value)
    assert epochs == [1]


@pytest.mark.slow
def test_figures_of_numpy_and_torch_are_kept_as_numbers(
    problem_of: Callable[..., Problem], tmp_path: Path
) -> None:
    learner = learner_of("bc", problem_of(), epochs=1)
    figures = {"loss": np.float32(0.5), "steps": np.int64(3), "norm": torch.tensor(0.25)}
    learner.__class__ = type("Foreign", (type(learner),), {"epoch": lambda _: figures})
    judge, protocol = (lambda _: {"validation_sr": 0.5}), PROTOCOLS["default"]
    done = fit(learner, judge, protocol, tmp_path / "checkpoint", {}, lambda _: None)
    assert (
        json.loads(json.dumps(done.history[0])).items()
        >= {"loss": 0.5, "steps": 3.0, "norm": 0.25}.items()
    )
