"""Pictures and actions are transformed together."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from labyrinth_core.language import load
from labyrinth_core.learning.networks.network import (
    SYMMETRIES,
    Averaged,
    transform,
    transformed_actions,
)
from labyrinth_core.pictures import render
from labyrinth_core.world import Labyrinth, State, Structure

pytestmark = pytest.mark.slow

FIGURE = Path(__file__).parents[2] / "data" / "valid" / "figure_1a_navigation.labyrinth"


def picture(labyrinth: Labyrinth, state: State) -> Tensor:
    return torch.tensor(render(labyrinth, state))[None]


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_a_transformed_action_does_what_the_action_did(symmetry: int) -> None:
    labyrinth = load(FIGURE)
    cells = torch.arange(9).reshape(1, 3, 3).flip(1)  # As pictures have them, from the top.
    where = {
        old: new for new, old in enumerate(transform(cells, symmetry).flip(1).flatten().tolist())
    }
    passages = [(where[low], where[high]) for low, high in labyrinth.structure.passages()]
    turned = Labyrinth(
        Structure.from_passages(3, 3, passages), where[labyrinth.start], where[labyrinth.goal]
    )
    for cell in range(9):
        seen = transform(picture(labyrinth, State(cell)), symmetry)
        # A wall between cells may lie a pixel beside where the middle is.
        apart = (seen.float() - picture(turned, State(where[cell])).float()).abs().mean()
        assert apart < 255 / 50
        for action in range(4):
            after = labyrinth.transition(State(cell), action).agent
            turned_action = transformed_actions(symmetry)[action]
            assert turned.transition(State(where[cell]), turned_action).agent == where[after]


def test_averaged_outputs_are_transformed_with_the_picture() -> None:
    torch.manual_seed(0)
    network = Averaged(nn.Sequential(nn.Flatten(), nn.Linear(6 * 6 * 3, 4))).eval()
    pictures = torch.rand(5, 6, 6, 3)
    straight = network(pictures)
    for symmetry in SYMMETRIES:
        turned = network(transform(pictures, symmetry))[:, transformed_actions(symmetry)]
        assert torch.allclose(turned, straight, atol=1e-5)
    assert not torch.allclose(network.network(pictures).log_softmax(1), straight, atol=1e-3)
    assert torch.equal(network.train()(pictures), network.network(pictures))
