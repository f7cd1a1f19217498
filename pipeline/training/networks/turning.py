"""The eight rotations and reflections of the square: pictures and actions turned together."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

SYMMETRIES = range(8)
"""Numbers of the symmetries; 0 leaves all as it is, from 4 on left and right are exchanged."""


def turn(pictures: Tensor, symmetry: int) -> Tensor:
    """Return pictures, or maps of cells, turned: quarters to the left, then mirrored or not.

    Args:
        pictures: Shape (N, rows, columns, ...), rows from the top.
        symmetry: One of `SYMMETRIES`.
    """
    turned = torch.rot90(pictures, symmetry % 4, (1, 2))
    return turned.flip(2) if symmetry >= 4 else turned


def turned_actions(symmetry: int) -> list[int]:
    """Return for each action the one that does the same in turned pictures."""
    # A quarter to the left makes left of up: one less in the order up, right, down, left.
    quarters = [(action - symmetry) % 4 for action in range(4)]
    return [-action % 4 for action in quarters] if symmetry >= 4 else quarters


def turn_examples(pictures: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
    """Return pictures and their labels, an eighth of them turned by each symmetry.

    Args:
        pictures: Shape (N, size, size, 3).
        labels: As in `relabelling.Examples`.
    """
    seen, told = [], []
    for symmetry in SYMMETRIES:
        # The last entry is for -1, which is no action.
        names = torch.tensor([*turned_actions(symmetry), -1], device=labels.device)
        some = names[labels[symmetry :: len(SYMMETRIES)]]
        seen.append(turn(pictures[symmetry :: len(SYMMETRIES)], symmetry))
        told.append(turn(some, symmetry) if some.dim() == 3 else some)
    return torch.cat(seen), torch.cat(told)


class Averaged(nn.Module):
    """A network that, where nothing is learnt, looks at a picture in several ways.

    Its scores are then the mean logarithms of the probabilities of the actions.
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network
        self.symmetries: Sequence[int] = SYMMETRIES
        """In which it looks; fewer cost less."""

    def forward(self, pictures: Tensor) -> Tensor:
        """Return scores of the four actions, shape (N, 4)."""
        if self.training:
            scores: Tensor = self.network(pictures)
            return scores
        views = [
            self.network(turn(pictures, each)).log_softmax(1)[:, turned_actions(each)]
            for each in self.symmetries
        ]
        return torch.stack(views).mean(0)
