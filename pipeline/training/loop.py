"""The training loop of all methods: train an epoch, evaluate, and keep the best policy."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path
from typing import Any

from labyrinth_core.learning import Learner
from pipeline.config import ConfigError, check
from pipeline.training import checkpoint
from pipeline.training.checkpoint import Progress

CHECKPOINT_SECONDS = 30.0
"""The minimum time between two checkpoints."""


@dataclass(frozen=True)
class Protocol:
    """When training ends."""

    evaluate_every: int | None = None
    """The number of epochs between evaluations; None for the method's own."""
    patience: float = inf
    """The number of evaluations without a better validation success rate that end training."""


PROTOCOLS = {
    "default": Protocol(),
    "paper": Protocol(evaluate_every=10, patience=5),
    "authors": Protocol(),
}
"""`default` and `paper` keep the policy with the best success rate on validation.

`default` trains for the method's whole budget, and shrinks pictures without losing walls. `paper`
resizes the authors' thin walls as they do, without antialiasing, so that most walls vanish. It
stops training like the authors' public script for BC: after five evaluations on the validation
labyrinths, ten epochs apart, without a better success rate, or after the method's epochs (a
thousand in that script). Here the other methods follow the same rule. `authors` is for the six
methods of the authors' later code, which have their own settings and selection, and are in
scripts/studies/methods/authors.
"""


def fit(
    learner: Learner,
    judge: Callable[[Learner], dict[str, float]],
    protocol: Protocol,
    path: Path,
    identity: Mapping[str, Any],
    report: Callable[[Progress], None],
    checkpoint_seconds: float = CHECKPOINT_SECONDS,
) -> Progress:
    """Train until the last epoch or early stopping, and return the run's progress.

    The policy is kept that is best by `Learner.is_better`.

    Args:
        learner: A fresh learner.
        judge: Returns the success rates of a learner's policy, among them `validation_sr`; called
            every `evaluate_every` epochs, and after the last epoch.
        protocol: When to stop early.
        path: The checkpoint; if it exists, training continues from it.
        identity: Everything that determines the run's weights.
        report: Called after every epoch.
        checkpoint_seconds: The minimum time between two checkpoints; they are written after epochs.

    Raises:
        ConfigError: A metric is not finite, the method returns no loss, or its state cannot be
            saved in a checkpoint. The last checkpoint stays unchanged.
    """
    checkpoint.state_of(learner)
    progress = checkpoint.load(path, learner, identity) if path.exists() else Progress()
    epochs = learner.settings.epochs
    every = protocol.evaluate_every or learner.settings.evaluate_every
    saved = time.perf_counter()
    began = saved - progress.seconds
    while progress.epoch < epochs and progress.stale < protocol.patience:
        if learner.problem.renewed is not None:
            learner.renew(learner.problem.renewed(learner.problem, progress.epoch))
        figures = _plain(learner.epoch())
        _require_finite(figures, progress.epoch + 1, learner.settings.learning_rate)
        progress.epoch += 1
        if progress.epoch == 1:
            checkpoint.state_of(learner)  # Fail now, not when the first checkpoint is due.
        if progress.epoch % every == 0 or progress.epoch == epochs:
            figures |= judge(learner)
        now = time.perf_counter()
        progress.seconds = now - began
        row = {"epoch": progress.epoch, "seconds": round(progress.seconds, 3)} | figures
        progress.history.append(row)
        if "validation_sr" in figures:
            _select(learner, progress)
        if now - saved >= checkpoint_seconds:
            checkpoint.save(path, learner, progress, identity)
            saved = now
        report(progress)
    return progress


def _select(learner: Learner, progress: Progress) -> None:
    """Keep the current policy if it is the best so far."""
    figures, best = progress.history[-1], progress.best
    higher = best is None or figures["validation_sr"] > best["validation_sr"]
    progress.stale = 0 if higher else progress.stale + 1
    if best is None or learner.is_better(figures, best):
        progress.best = figures
        state = learner.policy.state_dict()
        progress.weights = {name: tensor.detach().clone() for name, tensor in state.items()}


def _plain(figures: Any) -> dict[str, float]:
    """Return the metrics of an epoch as Python numbers.

    Raises:
        ConfigError: `figures` is not a dictionary of numbers, or has no loss.
    """
    try:
        plain = {
            str(name): value if isinstance(value, int | float) else float(value)
            for name, value in figures.items()
        }
        plain["loss"] += 0
    except (AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        returned = " ".join(repr(figures).split())
        raise ConfigError(
            f"the method's epoch returned {returned:.100}: it has to return a dictionary of "
            'numbers with the loss, such as {"loss": 0.5}'
        ) from error
    return plain


def _require_finite(figures: Mapping[str, float], epoch: int, rate: float) -> None:
    for name, value in figures.items():
        check(
            isfinite(value),
            f"method.learning_rate={rate}: {name} is {value} in epoch {epoch}, so that training "
            "cannot continue; give a lower rate. Existing files are unchanged",
        )
