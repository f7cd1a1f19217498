"""The eight symmetries of the square, applied to pictures and actions alike."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

SYMMETRIES = range(8)
"""Symmetries: 0 to 3 are quarter turns to the left; 4 to 7 are the same, then mirrored."""


def transform(pictures: Tensor, symmetry: int) -> Tensor:
    """Return pictures, or maps of cells, transformed by a symmetry.

    Args:
        pictures: Shape (N, rows, columns, ...), rows from the top.
        symmetry: One of `SYMMETRIES`.
    """
    turned = torch.rot90(pictures, symmetry % 4, (1, 2))
    return turned.flip(2) if symmetry >= 4 else turned


def transformed_actions(symmetry: int) -> list[int]:
    """Return for each action the equivalent action in transformed pictures."""
    # A quarter turn to the left maps up to left: one less in the order up, right, down, left.
    quarters = [(action - symmetry) % 4 for action in range(4)]
    return [-action % 4 for action in quarters] if symmetry >= 4 else quarters


def transform_examples(pictures: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
    """Transform an eighth of the examples by each symmetry of the square; return all of them.

    Args:
        pictures: Shape (N, size, size, 3).
        labels: The action of each picture, or of each cell; -1 for none.
    """
    seen, turned = [], []
    for symmetry in SYMMETRIES:
        # The last entry maps -1, which stands for no label, to itself.
        actions = torch.tensor([*transformed_actions(symmetry), -1], device=labels.device)
        some = actions[labels[symmetry :: len(SYMMETRIES)]]
        seen.append(transform(pictures[symmetry :: len(SYMMETRIES)], symmetry))
        turned.append(transform(some, symmetry) if some.dim() == 3 else some)
    return torch.cat(seen), torch.cat(turned)


class Averaged(nn.Module):
    """A network whose outputs in evaluation mode are averaged over the symmetries of its input.

    The averaged outputs are mean log-probabilities of the actions.
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network
        self.symmetries: Sequence[int] = SYMMETRIES
        """The symmetries to average over; fewer take less time."""

    def forward(self, pictures: Tensor) -> Tensor:
        """Return scores of the four actions, shape (N, 4)."""
        if self.training:
            scores: Tensor = self.network(pictures)
            return scores
        views = [
            self.network(transform(pictures, each)).log_softmax(1)[:, transformed_actions(each)]
            for each in self.symmetries
        ]
        return torch.stack(views).mean(0)
