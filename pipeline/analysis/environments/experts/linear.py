"""Linear policies, found by `random_search` and kept beside this file as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def kept_file(environment: str) -> Path:
    """Return where the policy of an environment is kept."""
    return Path(__file__).with_name(f"{environment}.json")


def kept_policy(environment: str) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Return the policy that is kept for an environment; the file says where it comes from."""
    values = json.loads(kept_file(environment).read_text(encoding="utf-8"))
    gain, bias = np.array(values["gain"]), np.array(values["bias"])

    def act(observation: NDArray[np.float64]) -> NDArray[np.float64]:
        action: NDArray[np.float64] = gain @ observation + bias
        return action

    return act
