"""The stage `train`, and its options.

This module does not import torch, so that `labyrinth-datasets --help` stays quick.
"""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.config import Stage, TrainingOptions, WorkOptions, option


@dataclass(frozen=True)
class TrainOptions(TrainingOptions, WorkOptions):
    """What is trained, and what is logged."""

    tensorboard: bool = option(False, "also write the learning curves for TensorBoard")


STAGES = {
    "train": Stage(
        "pipeline.training.train",
        TrainOptions,
        lambda job, _: job.options.check_training(),
        headings={"Training, by 'stages=[train,evaluate]'": TrainOptions},
    )
}
