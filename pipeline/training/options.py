"""The stage `train`, and its options.

This module does not import torch, so that `labyrinth-datasets --help` stays quick.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.config import Job, Stage, TrainingOptions, WorkOptions, option


@dataclass(frozen=True)
class TrainOptions(TrainingOptions, WorkOptions):
    """What is trained, and what is logged."""

    tensorboard: bool = option(False, "also write the learning curves for TensorBoard")


def _check(job: Job[TrainOptions], stages: Sequence[str]) -> None:  # noqa: ARG001
    job.options.check_training()


STAGES = {
    "train": Stage(
        "pipeline.training.train",
        TrainOptions,
        _check,
        headings={"Training, by 'stages=[train,evaluate]'": TrainOptions},
    )
}
