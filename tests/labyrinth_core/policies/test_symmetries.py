"""Pictures and actions are transformed together."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from support.policies import lay_out_run
from torch import Tensor

from labyrinth_core import load_policy
from labyrinth_core.language import load
from labyrinth_core.learning import NetworkSpec, PolicySpec
from labyrinth_core.learning.networks.network import transform_examples
from labyrinth_core.pictures import render
from labyrinth_core.world import Labyrinth, State, Structure

pytestmark = pytest.mark.slow

FIGURE = Path(__file__).parents[2] / "data" / "valid" / "figure_1a_navigation.labyrinth"


def transformed(pictures: Tensor, labels: Tensor) -> list[tuple[Tensor, Tensor]]:
    """Return N examples as each of the eight symmetries transforms them."""
    seen, told = transform_examples(*(each.repeat_interleave(8, 0) for each in (pictures, labels)))
    return [*zip(seen.split(len(pictures)), told.split(len(pictures)), strict=True)]


ACTIONS = [told.tolist() for _, told in transformed(torch.zeros(4, 1, 1), torch.arange(4))]
"""Symmetry -> the action in transformed pictures that is equivalent to each action."""


def picture(labyrinth: Labyrinth, state: State) -> Tensor:
    return torch.tensor(render(labyrinth, state))[None]


def test_a_transformed_action_does_what_the_action_did() -> None:
    labyrinth = load(FIGURE)
    nothing = torch.zeros(1, dtype=torch.int64)
    views = [transformed(picture(labyrinth, State(cell)), nothing) for cell in range(9)]
    cells = torch.arange(9).reshape(1, 3, 3).flip(1)  # As pictures have them, from the top.
    for symmetry, (moved, _) in enumerate(transformed(cells, nothing)):
        where = {old: new for new, old in enumerate(moved.flip(1).flatten().tolist())}
        passages = [(where[low], where[high]) for low, high in labyrinth.structure.passages()]
        turned = Labyrinth(
            Structure.from_passages(3, 3, passages), where[labyrinth.start], where[labyrinth.goal]
        )
        for cell, seen in enumerate(views):
            # A wall between cells may lie a pixel beside where the middle is.
            expected = picture(turned, State(where[cell])).float()
            assert (seen[symmetry][0].float() - expected).abs().mean() < 255 / 50
            for action, same in enumerate(ACTIONS[symmetry]):
                after = labyrinth.transition(State(cell), action).agent
                assert turned.transition(State(where[cell]), same).agent == where[after]
    assert len(set(map(tuple, ACTIONS))) == 8


def test_labels_of_all_cells_move_with_the_cells_and_none_stays_none() -> None:
    maps = torch.randint(-1, 4, (2, 3, 3))
    for names, (moved, told) in zip(ACTIONS, transformed(maps, maps), strict=True):
        assert torch.equal(told, torch.tensor([*names, -1])[moved])


def test_averaged_outputs_are_transformed_with_the_picture(tmp_path: Path) -> None:
    spec = PolicySpec(NetworkSpec("cnn", 3, 3, "navigation"), average=True)
    network = load_policy(lay_out_run(tmp_path / "run", spec)).network
    pictures = torch.randint(256, (5, 64, 64, 3), dtype=torch.uint8)
    none = torch.full((5,), -1)
    with torch.no_grad():
        straight, alone = network(pictures), network.network(pictures)
        for names, (turned, _) in zip(ACTIONS, transformed(pictures, none), strict=True):
            assert torch.allclose(network(turned)[:, names], straight, atol=1e-4)
    assert not torch.allclose(alone.log_softmax(1), straight, atol=1e-3)
    torch.manual_seed(0)
    network.train()
    first = network(pictures)
    torch.manual_seed(0)
    assert torch.equal(first, network.network(pictures))
