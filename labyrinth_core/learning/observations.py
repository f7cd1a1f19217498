"""The observations of states as tensors, held in memory or made when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from labyrinth_core.pictures import Looks


class Observations:
    """The observations of S states on a device, whether they are held or drawn when indexed."""

    def __init__(self, observations: NDArray[Any] | Looks, device: torch.device | str) -> None:
        """Hold the observations on the device if they are an array.

        Args:
            observations: The observations of `LabyrinthArrays`.
            device: The device to compute on.
        """
        self.device = torch.device(device)
        self._seen: Tensor | Looks = (
            observations
            if isinstance(observations, Looks)
            else torch.as_tensor(observations, device=self.device)
        )

    def __len__(self) -> int:
        """Return the number of states, S."""
        return len(self._seen)

    def __getitem__(self, states: NDArray[np.int64]) -> Tensor:
        """Return the observations of B states as a new tensor, shape (B, ...)."""
        if isinstance(self._seen, Looks):
            return torch.as_tensor(self._seen[states], device=self.device)
        # Indexing a tensor by [] is ten times slower.
        return self._seen.index_select(0, torch.as_tensor(states, device=self.device))


def parts_of(count: int, size: int) -> Iterator[NDArray[np.int64]]:
    """Yield the numbers from 0 to `count` - 1 in order, `size` at a time."""
    for begin in range(0, count, size):
        yield np.arange(begin, min(begin + size, count))
