"""The interface of a policy."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class Policy(Protocol):
    """A policy, which takes the action with the highest score."""

    def logits(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        """Return the scores of the four actions, shape (B, 4).

        Args:
            observations: uint8 (B, size, size, 3), or vectors (B, length).
        """
