"""Policies that remember what they have seen: the option `memory`, in training and evaluation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.policies.remembering import PictureMemory, Remembering
from pipeline.config.errors import ConfigError
from pipeline.config.run import Run
from pipeline.training.methods.method import Problem


def memory_of(run: Run, config: DatasetConfig, image_size: int) -> PictureMemory | None:
    """Return the memory of a run's policy for a config's labyrinths; None without `memory=true`.

    Raises:
        ConfigError: Pictures of `image_size` pixels are too small to remember.
    """
    if not run.options.memory:
        return None
    try:
        return PictureMemory(config.height, config.width, image_size)
    except ValueError as error:
        raise ConfigError(f"memory=true: {error}") from error


def with_memory(policy: Any, memory: PictureMemory | None) -> Any:
    """Return a policy that is shown the pictures of a memory, if one is given."""
    return policy if memory is None else Remembering(policy, memory)


def remembered(problem: Problem) -> Problem:
    """Return a problem whose demonstrations show all that was seen; each step is a new state."""
    pictures = torch.tensor(problem.examples.look_at_all(), device=problem.device)
    states = len(problem.observations) + np.arange(len(pictures))
    return replace(
        problem,
        observations=torch.cat([problem.observations, pictures]),
        demonstrations=problem.demonstrations._replace(states=states),
    )
