"""Experts for Gymnasium's environments: closed-form controllers, linear policies, archives."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.studies.environments.experts import classic
from pipeline.studies.environments.stable_baselines import located, read_archive

Expert = Callable[[NDArray[np.float64]], "int | NDArray[np.float64]"]
"""Observation -> action: a number, or numbers that are still to be clipped to the action space."""

_CONTROLLERS: dict[str, Expert] = {
    "CartPole-v1": classic.balance_the_pole,
    "MountainCar-v0": classic.climb_the_mountain,
}


def expert_of(environment: str, archive: str | None = None) -> Expert:
    """Return the expert of an environment.

    Args:
        environment: Its name in Gymnasium.
        archive: A Stable-Baselines3 archive to use instead of our expert, as a path or an id on
            the Hub.

    Raises:
        DatasetError: The archive cannot be read.
    """
    if archive is not None:
        return read_archive(archive)
    if environment in _CONTROLLERS:
        return _CONTROLLERS[environment]
    # A linear policy of augmented random search; docs/results/ARCHIVE.md says how it was made.
    values = json.loads(source_of(environment).read_text(encoding="utf-8"))
    gain, bias = np.array(values["gain"]), np.array(values["bias"])
    return lambda observation: gain @ observation + bias


def source_of(environment: str, archive: str | None = None) -> Path:
    """Return the file that determines what the expert of an environment does.

    Raises:
        DatasetError: There is no such archive.
    """
    if archive is not None:
        return located(archive)
    if environment in _CONTROLLERS:
        return Path(classic.__file__)
    return Path(__file__).with_name(f"{environment}.json")
