"""The network of `method=planner`: a picture into a map of costs, the map into shortest ways.

A small stem of convolutions, alike everywhere, says for each position of an internal grid what
leaving it in each direction costs, and what it costs to end there. Planning is then the iteration
of Bellman and Ford, with tied weights because it has none:

    d(s) <- min(end(s), min over a of step(s, a) + d(s after a))

which sees the costs again in every iteration and comes to rest by itself, after more iterations in
larger labyrinths. The scores of the actions are -(step + d), where the agent is. All is
differentiable, so what a wall, a goal or ice looks like is learnt from demonstrated actions alone.
"""

from __future__ import annotations

from math import log

import torch
from torch import Tensor, nn
from torch.nn import functional

from labyrinth_core.pictures.renderer import DEFAULT_STYLE
from pipeline.training.networks.network import ACTIONS, as_input

FAR = 1e9
"""What ending outside of the picture costs."""
FIRST_END = 3.0
"""Logarithm of what ending costs at first, as much as a way of twenty cells."""
POSITION_PIXELS = 4
"""Of the side of a position, without `grid_prior`."""
FINE_POSITIONS = 3.2
"""As how many on the side of a cell these are taken without `grid_prior`, so many as at 5x5: how
long planning goes on while learning, and how dear ending is at first, depend on it."""
FINE_SHARPNESS = 1.25
"""Of `Bellman`, when acting, without `grid_prior`: a way through a cell then has several positions,
dear and cheap ones, and high powers of their costs add up to other ways. Chosen among 1, 1.25, 1.5
and 1.75 on structures of the split validation of 5x5."""
PIXELS = 16
"""To which the picture of a cell is brought, with `grid_prior`."""
SAME_COLOUR = 0.1
"""Difference in each channel, of 1, up to which a pixel has the agent's colour."""


class Bellman(nn.Module):
    """The prior that costs add up along a way, and that the cheapest way is taken."""

    def __init__(
        self, channels: int, iterations: int, sharpness: float, first_end: float = FIRST_END
    ) -> None:
        super().__init__()
        self.costs = nn.Conv2d(channels, ACTIONS + 1, 1)
        # At first it is dear to end anywhere, so that there is a way to learn about.
        nn.init.constant_(self.costs.bias[ACTIONS:], first_end)  # type: ignore[index]
        self.iterations = iterations
        self.sharpness = sharpness

    def forward(self, scene: Tensor) -> Tensor:
        """Return the scores of the actions at each position, shape (N, 4, rows, columns)."""
        logarithms: Tensor = self.costs(scene)
        if self.training:
            ways = self.ways(logarithms.exp(), self.iterations)
        else:
            # Double, since a wall costs far more than a step; as many iterations as there are
            # positions are the longest way.
            sharp = (self.sharpness * logarithms.double()).exp()
            ways = self.ways(sharp, logarithms[0, 0].numel())
            ways = (ways - ways.amin(1, keepdim=True)).float()
        return -ways

    def ways(self, costs: Tensor, iterations: int) -> Tensor:
        """Return what the cheapest way costs that begins with each action, until it rests.

        Args:
            costs: Of the four steps, and of ending, at each position, shape (N, 5, ...).
            iterations: At most.
        """
        step, end = costs[:, :ACTIONS], costs[:, ACTIONS]
        distance = end
        for _ in range(iterations):
            nearer = torch.minimum(end, (step + _beside(distance)).amin(1))
            if not self.training and torch.equal(nearer, distance):
                break
            distance = nearer
        return step + _beside(distance)


def _beside(distance: Tensor) -> Tensor:
    """Return what is above, right, below and left of each position, shape (N, 4, ...)."""
    around = functional.pad(distance, (1, 1, 1, 1), value=FAR)
    sides = (around[:, :-2, 1:-1], around[:, 1:-1, 2:], around[:, 2:, 1:-1], around[:, 1:-1, :-2])
    return torch.stack(sides, 1)


class Gated(nn.Module):
    """What takes the place of `Bellman` without that prior: a convolution, again and again.

    It sees the scene again in every iteration (recall: Bansal et al. 2022).
    """

    def __init__(self, channels: int, iterations: int) -> None:
        super().__init__()
        self.recall = nn.Conv2d(channels, 2 * channels, 3, padding=1)
        self.think = nn.Conv2d(channels, 2 * channels, 3, padding=1, bias=False)
        self.read = nn.Conv2d(channels, ACTIONS, 1)
        self.iterations = iterations

    def forward(self, scene: Tensor) -> Tensor:
        """Return the scores of the actions at each position, shape (N, 4, rows, columns)."""
        recalled, thought = self.recall(scene), torch.zeros_like(scene)
        for _ in range(self.iterations):
            gate, new = (recalled + self.think(thought)).chunk(2, 1)
            thought = torch.lerp(thought, new.tanh(), gate.sigmoid())
        scores: Tensor = self.read(thought)
        return scores


class Planner(nn.Module):
    """Stem, planning, and a look at what is planned where the agent is."""

    def __init__(
        self,
        cell_pixels: float,
        *,
        channels: int,
        iterations: int,
        sharpness: float,
        path_prior: bool,
        grid_prior: bool,
        colour_prior: bool,
    ) -> None:
        """Draw the weights.

        Args:
            cell_pixels: Of the side of a cell, in pictures; told by `grid_prior` alone.
            channels: Features of a position.
            iterations: Of planning, in cells.
            sharpness: Of `Bellman`, when acting, with `grid_prior`.
            path_prior: Whether planning is `Bellman`, or else `Gated`.
            grid_prior: Whether the internal grid has one position a cell, or else one every
                `POSITION_PIXELS`.
            colour_prior: Whether the agent is found by its colour, or else by learned attention.
        """
        super().__init__()
        self.cell_pixels = cell_pixels
        self.grid_prior = grid_prior
        middle = nn.Conv2d(channels, channels, 6, stride=4, padding=1)
        if not grid_prior:
            middle = nn.Conv2d(channels, channels, 3, padding=1)
        self.stem = nn.Sequential(
            nn.Conv2d(3, channels, POSITION_PIXELS, stride=POSITION_PIXELS),
            nn.ReLU(),
            middle,
            nn.ReLU(),
            nn.Conv2d(channels, channels, 1),
            nn.ReLU(),
        )
        positions = 1.0 if grid_prior else FINE_POSITIONS
        steps, power = round(iterations * positions), sharpness if grid_prior else FINE_SHARPNESS
        self.planning = (
            Bellman(channels, steps, power, FIRST_END + log(positions))
            if path_prior
            else Gated(channels, steps)
        )
        self.attention = None if colour_prior else nn.Conv2d(channels, 1, 1)
        self.colour: Tensor
        colour = torch.tensor(DEFAULT_STYLE.agent).view(3, 1, 1) / 255
        self.register_buffer("colour", colour, persistent=False)

    def forward(self, pictures: Tensor) -> Tensor:
        """Return the logarithms of the actions' probabilities where the agent is, shape (N, 4)."""
        image = as_input(pictures)
        scene = self.see(image)
        plan: Tensor = self.planning(scene).log_softmax(1)
        return (plan + self.find(image, scene)[:, None]).logsumexp((2, 3))

    def plan(self, pictures: Tensor) -> Tensor:
        """Return the scores of the actions at each position, shape (N, 4, rows, columns)."""
        plan: Tensor = self.planning(self.see(as_input(pictures)))
        return plan

    def see(self, image: Tensor) -> Tensor:
        """Return the features of each position, shape (N, channels, rows, columns)."""
        if self.grid_prior:
            side = PIXELS * round(image.shape[2] / self.cell_pixels)
            image = functional.interpolate(image, size=(side, side), mode="bilinear")
        scene: Tensor = self.stem(image)
        return scene

    def find(self, image: Tensor, scene: Tensor) -> Tensor:
        """Return the logarithm of the agent's share at each position, shape (N, rows, columns)."""
        shape = scene[:, 0].shape
        if self.attention is not None:
            attention: Tensor = self.attention(scene)
            return attention.flatten(1).log_softmax(1).view(shape)
        green = (image - self.colour).abs().amax(1) < SAME_COLOUR
        share = functional.adaptive_avg_pool2d(green.float(), (shape[1], shape[2]))
        return (share / share.sum((1, 2), keepdim=True).clamp(min=1e-6)).log()
