"""The training loop, the same for every method: an epoch, a look at validation, the best kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from labyrinth_core.evaluation.policy import Policy
from pipeline.config.training import Protocol
from pipeline.training import checkpoint
from pipeline.training.checkpoint import Progress
from pipeline.training.methods.method import Learner
from pipeline.training.policy import NetworkPolicy

CHECKPOINT_SECONDS = 30.0
"""Of training that an interruption costs at most, and an epoch."""

Judge = Callable[[Policy], dict[str, float]]
"""Returns the success rates of a policy, `validation_sr` among them."""


def fit(
    learner: Learner,
    judge: Judge,
    protocol: Protocol,
    path: Path,
    identity: Mapping[str, Any],
    report: Callable[[Progress], None],
) -> Progress:
    """Train until the epochs are over, or the protocol says so; go on from a checkpoint.

    The policy that is kept is the one with the best SR on validation, of several the last.

    Args:
        learner: Fresh.
        judge: Tries the policy, every `evaluate_every` epochs and after the last.
        protocol: When to stop.
        path: Of the checkpoint, of an earlier run if it is there.
        identity: What the run is.
        report: Is told after every epoch.
    """
    progress = checkpoint.load(path, learner, identity) if path.exists() else Progress()
    settings = learner.settings
    every = protocol.evaluate_every or settings.evaluate_every
    saved = time.perf_counter()
    began = saved - progress.seconds
    while progress.epoch < settings.epochs and not _is_over(progress, protocol):
        figures = learner.epoch()
        progress.epoch += 1
        if progress.epoch % every == 0 or progress.epoch == settings.epochs:
            figures |= judge(NetworkPolicy(learner.policy))
        now = time.perf_counter()
        progress.seconds = now - began
        progress.history.append(
            {"epoch": progress.epoch, "seconds": round(progress.seconds, 3)} | figures
        )
        if "validation_sr" in figures:
            _select(learner, progress)
        if now - saved >= CHECKPOINT_SECONDS:
            checkpoint.save(path, learner, progress, identity)
            saved = now
        report(progress)
    return progress


def _is_over(progress: Progress, protocol: Protocol) -> bool:
    return protocol.patience is not None and progress.stale >= protocol.patience


def _select(learner: Learner, progress: Progress) -> None:
    """Keep the policy if no earlier one was better on validation."""
    figures = progress.history[-1]
    best = -1.0 if progress.best is None else progress.best["validation_sr"]
    progress.stale = 0 if figures["validation_sr"] > best else progress.stale + 1
    if figures["validation_sr"] >= best:
        progress.best = figures
        state = learner.policy.state_dict()
        progress.weights = {name: tensor.detach().clone() for name, tensor in state.items()}
