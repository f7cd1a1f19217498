"""The network of `method=planner`: it predicts a map of costs and plans shortest paths on it.

A small convolutional stem predicts, for each position of an internal grid, the cost of a step in
each direction and the cost of ending there. Planning is then the Bellman-Ford iteration, which has
no weights of its own:

    d(s) <- min(end(s), min over a of step(s, a) + d(s after a))

Every iteration reuses the costs, and the iteration converges by itself, later in larger labyrinths.
The scores of the actions are -(step + d) at the agent's position. Everything is differentiable, so
the appearance of walls, goal and ice is learnt from the demonstrated actions alone.
"""

from __future__ import annotations

from math import log

import torch
from torch import Tensor, nn
from torch.nn import functional

from labyrinth_core.learning.networks.network import ACTIONS, as_input, double
from labyrinth_core.learning.spec import PlannerSpec
from labyrinth_core.pictures import DEFAULT_STYLE, Colour

FAR = 1e9
"""The cost of ending outside the picture."""
FIRST_END = 3.0
"""The initial logarithm of the cost of ending, about the cost of a path of twenty cells."""
POSITION_PIXELS = 4
"""The side of a position in pixels, without `grid_prior`."""
FINE_POSITIONS = 3.2
"""The number of positions along the side of a cell, assumed without `grid_prior` and right for 5x5:
it scales the iterations in training and the initial cost of ending."""
FINE_SHARPNESS = 1.25
"""The sharpness of `Bellman` in evaluation mode without `grid_prior`, where a path through a cell
has several positions of different costs, so that high powers of the costs change the cheapest path.
Chosen from 1, 1.25, 1.5 and 1.75 on structures of the split validation of 5x5."""
PIXELS = 16
"""The side in pixels to which each cell is resized, with `grid_prior`."""
SAME_COLOUR = 0.1
"""The largest difference per channel, from 0 to 1, at which a pixel counts as of a colour."""


class Bellman(nn.Module):
    """Planning with the prior that costs add up along a path, and the cheapest path is taken."""

    def __init__(
        self, channels: int, iterations: int, sharpness: float, first_end: float = FIRST_END
    ) -> None:
        super().__init__()
        self.costs = nn.Conv2d(channels, ACTIONS + 1, 1)
        # Ending is expensive at first, so that the cheapest paths have steps to learn from.
        nn.init.constant_(self.costs.bias[ACTIONS:], first_end)  # type: ignore[index]
        self.iterations = iterations
        self.sharpness = sharpness

    def forward(self, scene: Tensor) -> Tensor:
        """Return the scores of the actions at each position, shape (N, 4, rows, columns)."""
        logarithms: Tensor = self.costs(scene)
        if self.training:
            paths = path_costs(logarithms.exp(), self.iterations)
        else:
            # Double precision, since a wall costs far more than a step. No cheapest path has more
            # steps than there are positions.
            sharp = (self.sharpness * double(logarithms)).exp()
            paths = path_costs(sharp, logarithms[0, 0].numel(), rest=True)
            paths = (paths - paths.amin(1, keepdim=True)).float().to(scene.device)
        return -paths


def path_costs(costs: Tensor, iterations: int, *, rest: bool = False) -> Tensor:
    """Return the cost of the cheapest path that begins with each action.

    Args:
        costs: The costs of the four steps, and of ending, at each position, shape (N, 5, ...).
        iterations: The greatest number of iterations.
        rest: Whether to stop as soon as nothing changes; or at once, if a cost is not a number.
    """
    if rest and costs.isnan().any():
        iterations = 0  # Nothing would ever be equal.
    step, end = costs[:, :ACTIONS], costs[:, ACTIONS]
    distance = end
    for _ in range(iterations):
        nearer = torch.minimum(end, (step + _neighbours(distance)).amin(1))
        if rest and torch.equal(nearer, distance):
            break
        distance = nearer
    return step + _neighbours(distance)


def _neighbours(distance: Tensor) -> Tensor:
    """Return the distances above, right, below and left of each position, shape (N, 4, ...)."""
    around = functional.pad(distance, (1, 1, 1, 1), value=FAR)
    sides = (around[:, :-2, 1:-1], around[:, 1:-1, 2:], around[:, 2:, 1:-1], around[:, 1:-1, :-2])
    return torch.stack(sides, 1)


class Gated(nn.Module):
    """Planning without the prior of `Bellman`: an iterated gated convolution.

    Its input includes the scene in every iteration (recall: Bansal et al. 2022).
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
    """The stem, the planning, and the look-up of the agent's position in the plan."""

    def __init__(self, cell_pixels: float, settings: PlannerSpec) -> None:
        """Draw the weights.

        Without `grid_prior` the internal grid has one position every `POSITION_PIXELS`; without
        `colour_prior` learned attention finds the agent.

        Args:
            cell_pixels: The side of a cell in pixels; used only with `grid_prior`.
            settings: The priors and sizes.
        """
        super().__init__()
        channels, self.grid_prior = settings.channels, settings.grid_prior
        self.cell_pixels = cell_pixels
        middle = nn.Conv2d(channels, channels, 6, stride=4, padding=1)
        if not self.grid_prior:
            middle = nn.Conv2d(channels, channels, 3, padding=1)
        self.stem = nn.Sequential(
            nn.Conv2d(3, channels, POSITION_PIXELS, stride=POSITION_PIXELS),
            nn.ReLU(),
            middle,
            nn.ReLU(),
            nn.Conv2d(channels, channels, 1),
            nn.ReLU(),
        )
        positions, sharpness = 1.0, settings.sharpness
        if not self.grid_prior:
            positions, sharpness = FINE_POSITIONS, FINE_SHARPNESS
        steps = round(settings.iterations * positions)
        self.planning = (
            Bellman(channels, steps, sharpness, FIRST_END + log(positions))
            if settings.path_prior
            else Gated(channels, steps)
        )
        self.attention = None if settings.colour_prior else nn.Conv2d(channels, 1, 1)

    def forward(self, pictures: Tensor) -> Tensor:
        """Return the logarithms of the agent's action probabilities, shape (N, 4)."""
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
        scene: Tensor = self.stem(on_grid(image, self.cell_pixels) if self.grid_prior else image)
        return scene

    def find(self, image: Tensor, scene: Tensor) -> Tensor:
        """Return the logarithm of the agent's weight at each position, (N, rows, columns)."""
        shape = scene[:, 0].shape
        if self.attention is not None:
            attention: Tensor = self.attention(scene)
            return attention.flatten(1).log_softmax(1).view(shape)
        return share_of(image, DEFAULT_STYLE.agent, shape[1], shape[2]).log()


def on_grid(image: Tensor, cell_pixels: float) -> Tensor:
    """Resize pictures so that each cell has `PIXELS` pixels each way, shape (N, 3, side, side).

    Args:
        image: Pictures of square labyrinths, shape (N, 3, size, size).
        cell_pixels: The side of a cell in these pictures, in pixels.
    """
    side = PIXELS * round(image.shape[2] / cell_pixels)
    return functional.interpolate(image, size=(side, side), mode="bilinear")


def share_of(image: Tensor, colour: Colour, rows: int, columns: int) -> Tensor:
    """Return the share of a colour at each position, with sum 1, shape (N, rows, columns).

    If a picture lacks the colour, all positions have the same share.
    """
    same = image.new_tensor(colour).view(3, 1, 1) / 255
    has_colour = (image - same).abs().amax(1) < SAME_COLOUR
    share = functional.adaptive_avg_pool2d(has_colour.float(), (rows, columns))
    total = share.sum((1, 2), keepdim=True)
    share = torch.where(total > 0, share, 1.0)  # In other colours, the agent may be anywhere.
    return share / share.sum((1, 2), keepdim=True).clamp(min=1e-6)
