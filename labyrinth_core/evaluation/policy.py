"""What acts: the interface that every policy has."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class Policy(Protocol):
    """What is evaluated; the action is that of the highest score."""

    def logits(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        """Return scores of the actions, shape (B, 4).

        Args:
            observations: uint8 (B, size, size, 3), or vectors (B, length).
        """
