"""Experts for Gymnasium's environments: controllers in closed form, kept policies, archives."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.analysis.environments.experts import classic
from pipeline.analysis.environments.experts.linear import kept_file, kept_policy
from pipeline.analysis.environments.experts.stable_baselines import located, read_archive

Expert = Callable[[NDArray[np.float64]], "int | NDArray[np.float64]"]
"""Observation -> action: a number, or numbers that are still to be cut to the action space."""

_CONTROLLERS: dict[str, Expert] = {
    "CartPole-v1": classic.balance_the_pole,
    "MountainCar-v0": classic.climb_the_mountain,
}


def expert_of(environment: str, archive: str | None = None) -> Expert:
    """Return the expert of an environment.

    Args:
        environment: Its name in Gymnasium.
        archive: A Stable-Baselines3 archive to take instead of ours, as a path or an id on the
            Hub.

    Raises:
        DatasetError: The archive cannot be read.
    """
    if archive is not None:
        return read_archive(archive)
    return _CONTROLLERS.get(environment) or kept_policy(environment)


def source_of(environment: str, archive: str | None = None) -> Path:
    """Return the file that settles what the expert of an environment does.

    Raises:
        DatasetError: The archive is not to be had.
    """
    if archive is not None:
        return located(archive)
    return Path(classic.__file__) if environment in _CONTROLLERS else kept_file(environment)
