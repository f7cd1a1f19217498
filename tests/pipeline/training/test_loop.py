"""The loop of all methods: where training cannot go on."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan
from pathlib import Path

import pytest
from method_settings import settings_of

from pipeline.config.errors import ConfigError
from pipeline.config.run import Run
from pipeline.config.training import PROTOCOLS
from pipeline.training import train
from pipeline.training.loop import fit
from pipeline.training.methods import bc
from pipeline.training.methods.method import Problem
from pipeline.training.record import CHECKPOINT


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
def test_a_learning_rate_that_breaks_the_weights_leaves_no_finished_run(
    small_dataset: Run, make_run: Callable[..., Run], tmp_path: Path
) -> None:
    run = make_run(
        small_dataset.data_dir,
        stages=["train"],
        run_dir=str(tmp_path),
        method={"name": "bc", "epochs": 20, "learning_rate": 1e30},
    )
    with pytest.raises(ConfigError, match=r"method\.learning_rate=1e\+30: loss is nan in epoch"):
        train.run(run, checkpoint_seconds=0)
    assert {path.name for path in run.training_folder.iterdir()} <= {CHECKPOINT}
