"""The network and the policy of `method=mapper`: it learns a model of actions, and plans with it.

A picture is split into anonymous slots, one per colour (`slots`). The network learns four things:

- which slot moves, from the shape of each slot within cells, and of the other slots in these cells;
- where demonstrations end: which slot of an episode's first picture, from the same shapes;
- what each action does: by how many rows and columns it moves the agent, if it does;
- what lets the agent pass: whether a move happens, from all slots on the way from a cell to the
  next, each represented by features that are computed from its shape.

Together they are a model of where each action leads from each cell. The plan minimises the expected
number of steps: a move of probability p takes 1 / p attempts.

Given, not learnt: pixels have flat colours, and a colour means one thing in the whole picture; the
numbers of rows and columns; the agent is one colour in one cell, a step leads at most to one of the
eight cells around it, and the first picture shows where the episode ends; passages look the same
when turned; the shortest route is the best. Not given: which colour is the agent, a wall, the
floor, the start or the goal, what they look like, what the actions do, that anything blocks, and
any labyrinth of another size or look.

Colours are only compared for equality, and no feature of a slot depends on its position: a goal
that is always in the same corner is not recognised by the corner.
"""

from __future__ import annotations

from copy import copy
from typing import NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from labyrinth_core.evaluation import PolicyError
from labyrinth_core.learning.networks.network import ACTIONS, double
from labyrinth_core.learning.networks.slots import (
    CELL,
    Slots,
    Surroundings,
    masks_of,
    patches_of,
    places_of,
)
from labyrinth_core.learning.spec import MapperSpec
from labyrinth_core.pictures import PICTURE_SIZE
from labyrinth_core.world import Task

AROUND = ((-1, 0), (0, 1), (1, 0), (0, -1), (-1, 1), (1, 1), (1, -1), (-1, -1))
"""The moves to another cell, in rows down and columns right; within each four, one is turned."""
STAY = len(AROUND)
"""The index of the outcome of a step that does not leave the cell."""
QUICK = 20.0
"""The factor of `effects` as logits; without it so few weights would learn too slowly."""
TOGETHER = 16
"""The number of pictures for which plans are made at once."""


class Roles(NamedTuple):
    """The predicted roles of K slots in N pictures; logits are -inf if a picture lacks the slot."""

    moves: Tensor
    """The logit that a slot is the one that moves, shape (N, K)."""
    ends: Tensor
    """The logit that the demonstration ends where a slot is, shape (N, K)."""
    looks: Tensor
    """The features of a slot on the way to another cell, shape (N, K, features)."""


class Mapper(nn.Module):
    """The model of the slots' roles, and of where actions lead."""

    def __init__(self, settings: MapperSpec) -> None:
        """Initialise the weights, which do not depend on the size of labyrinths."""
        super().__init__()
        channels, looks = settings.channels, settings.looks
        self.shape = nn.Sequential(
            nn.Linear(CELL**2, channels), nn.ReLU(), nn.Linear(channels, channels), nn.ReLU()
        )
        self.beside = nn.Sequential(nn.Linear(2 * channels, channels), nn.ReLU())
        self.role = nn.Sequential(
            nn.Linear(2 * channels, channels), nn.ReLU(), nn.Linear(channels, 2 + looks)
        )
        self.passing = nn.Sequential(
            nn.Linear(CELL * looks, 2 * channels), nn.ReLU(), nn.Linear(2 * channels, 1)
        )
        self.effects = nn.Parameter(torch.zeros(ACTIONS, len(AROUND) + 1))

    def roles(self, masks: Tensor) -> Roles:
        """Return each slot's roles, from its shape and the other slots' shapes in its cells."""
        patches = patches_of(masks)
        used = patches.amax((3, 4))
        # The mean over a cell's eight symmetries; otherwise the walls' width would show the corner.
        turned = patches + patches.flip(3)
        turned = turned + turned.flip(4)
        turned = (turned + turned.transpose(3, 4)) / 8
        features = self.shape(turned.flatten(3)) * used[..., None]
        others = features.sum(1, keepdim=True) - features
        features = self.beside(torch.cat([features, others], 3)) * used[..., None]
        count = used.sum(2)
        mean = features.sum(2) / count.clamp(min=1)[..., None]
        role = self.role(torch.cat([features.amax(2), mean], 2))
        moves, ends = role[..., :2].masked_fill(count[..., None] == 0, -torch.inf).unbind(2)
        looks = functional.layer_norm(role[..., 2:], role[0, 0, 2:].shape)  # At a useful scale.
        return Roles(moves, ends, looks)

    def passable(self, seen: Tensor) -> Tensor:
        """Return the logits that the agent can pass from each cell to the eight cells around it.

        A way is as passable as the least passable line of blocks across it.

        Args:
            seen: The result of `Surroundings.on_ways` for N pictures and the directions `AROUND`.

        Returns:
            Shape (N, cells, 8).
        """
        logits: Tensor = self.passing(seen.transpose(3, 4).flatten(4))
        return logits[..., 0].amin(3)

    def outcomes(self, passable: Tensor) -> Tensor:
        """Return the log-probabilities of the outcomes of each action.

        Args:
            passable: Logits, shape (N, 8).

        Returns:
            Shape (N, 4, 9); the last outcome is `STAY`.
        """
        effects = (QUICK * self.effects).log_softmax(1)[None]
        logits = passable[:, None]
        go = effects[:, :, :STAY] + functional.logsigmoid(logits)
        blocked = effects[:, :, :STAY] + functional.logsigmoid(-logits)
        stay = torch.cat([effects[:, :, STAY:].expand_as(blocked[:, :, :1]), blocked], 2)
        return torch.cat([go, stay.logsumexp(2, keepdim=True)], 2)

    def plan(self, masks: Tensor) -> tuple[Tensor, Tensor]:
        """Return the slot that moves, shape (N,), and the action in each cell, shape (N, cells).

        Raises:
            PolicyError: The weights are not finite, or so large that sums of them are not.
        """
        roles, places = self.roles(masks), places_of(masks)
        movers = roles.moves.argmax(1)
        ends = torch.einsum("nk,nkc->nc", roles.ends.softmax(1), places).argmax(1)
        surroundings = Surroundings.of(masks, movers)
        plans = []
        for picture, end in enumerate(ends):
            around = Surroundings(*(each[picture, None] for each in surroundings))
            seen = around.on_ways(roles.looks[picture, None], AROUND)
            outcomes = self.outcomes(self.passable(seen)[0])
            steps, actions = (-double(outcomes[:, :, :STAY])).exp().min(1)
            if steps.isnan().any():
                raise PolicyError(
                    "the mapper computes nan: its weights are not finite, or too large"
                )
            best = _quickest(steps.T.unflatten(1, surroundings.grid), int(end))
            plans.append(actions.gather(1, best[:, None])[:, 0])
        return movers, torch.stack(plans).to(masks.device)


def _quickest(steps: Tensor, end: int) -> Tensor:
    """Return the move in each cell that minimises the steps to the end, shape (cells,).

    Args:
        steps: The expected number of steps that each move takes, shape (8, rows, columns); one or
            more, or infinite.
        end: A cell.
    """
    distance = torch.full_like(steps[0], torch.inf)
    distance.view(-1)[end] = 0
    while True:  # It ends: no shortest route has more moves than there are cells.
        padded = functional.pad(distance, (1, 1, 1, 1), value=torch.inf)
        beside = [
            padded[1 + down :, 1 + right :][: len(distance), : distance.shape[1]]
            for down, right in AROUND
        ]
        ways = steps + torch.stack(beside)
        nearer = torch.minimum(distance, ways.amin(0))
        if torch.equal(nearer, distance):
            return ways.argmin(0).flatten()
        distance = nearer


class MapperPolicy:
    """The policy of a mapper, which remembers its plan and the agent's colour.

    It plans for the first picture of an episode; in later pictures it only locates the agent.
    """

    observation, image_size = "image", PICTURE_SIZE

    def __init__(self, network: Mapper, height: int, width: int, *, remember: bool = True) -> None:
        """Begin with no episode.

        Args:
            network: The network, trained on labyrinths of any size.
            height: The number of rows of the labyrinths in the pictures.
            width: The number of columns.
            remember: Whether to remember the plan; if not, it plans anew for each picture.
        """
        self.network, self.size, self.remember = network, (height, width), remember
        self.reset(0)

    def for_labyrinths(self, height: int, width: int, task: Task) -> Self:  # noqa: ARG002
        """Return the policy for labyrinths of another size, with no episode begun."""
        adapted = copy(self)
        adapted.size = (height, width)
        adapted.reset(0)
        return adapted

    def reset(self, count: int) -> None:
        """Begin `count` episodes."""
        self._count, self._colours = count, np.zeros(0, np.uint32)
        self._plans = np.zeros((0, count), np.int64)

    def act(
        self, observations: NDArray[np.uint8], episodes: NDArray[np.int64] | None = None
    ) -> NDArray[np.int64]:
        """Return the actions, shape (N,).

        Args:
            observations: Pictures, shape (N, side, side, 3).
            episodes: The number of the episode of each picture, shape (N,); None for all episodes.
                The first pictures have to be of all of them.

        Raises:
            ValueError: The pictures have more colours than flat ones have.
        """
        pictures = [Slots.of(each) for each in observations]
        if not (self.remember and len(self._colours)):
            self._begin(pictures)
            episodes = None  # The plans are those of these pictures.
        episodes = np.arange(len(pictures)) if episodes is None else episodes
        cells = [
            each.cell_of(colour, *self.size)
            for each, colour in zip(pictures, self._colours[episodes].tolist(), strict=True)
        ]
        return self._plans[episodes, cells]

    def remembered(self) -> NDArray[np.int64]:
        """Return the memory of each episode: the agent's colour, and the action in each cell."""
        if not self.remember:
            return np.zeros((self._count, 0), np.int64)
        return np.column_stack([self._colours, self._plans])

    def _begin(self, pictures: list[Slots]) -> None:
        plans, colours = [], []
        device = next(self.network.parameters()).device
        for begin in range(0, len(pictures), TOGETHER):
            part = pictures[begin : begin + TOGETHER]
            scenes = np.stack([each.scene(*self.size) for each in part])
            with torch.no_grad():
                movers, actions = self.network.plan(masks_of(scenes).to(device))
            plans.append(actions.cpu().numpy())
            colours += [each.colours[mover] for each, mover in zip(part, movers, strict=True)]
        self._plans, self._colours = np.concatenate(plans), np.array(colours, np.uint32)
