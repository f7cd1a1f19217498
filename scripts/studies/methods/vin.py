"""A value iteration network (Tamar, Wu, Thomas, Levine and Abbeel 2016), trained by imitation.

As in the paper, a convolutional network turns the picture into a map of rewards R, and the value
iteration module (section 4) repeats K times, with the same weights,

    Q(a, s) = sum over s' near s of W_R(a, s' - s) R(s') + W_V(a, s' - s) V(s')
    V(s) = max over a of Q(a, s)

where near s are the 3 x 3 positions around it, and a are ten channels that stand for no particular
action: what an action does is learnt. Attention picks Q where the agent is, and a linear layer
turns that into scores of the four actions. The loss is the cross-entropy of the demonstrated
action. Initial weights of R and of the module are normal, a hundredth in size.

In the paper's grid worlds the input is the map, one pixel a position, with the goal and the agent's
position. Here it is the picture. So the method is given the number of pixels of a cell and the
agent's colour, like `planner` by default: a first convolution has one position for each cell, for
each wall between two cells and for each corner, which makes 11 x 11 of 5x5, and the agent is where
its colour is. What wall and goal look like is learnt.

Departures: that first convolution, with a rectified linear unit; Adam instead of RMSProp; gradients
are clipped. K grows with the side of the labyrinth, as the paper chooses it for each size; here
weights of one size are used at others.

`augment`, `relabel` and `average` are not part of the paper, and off by default: see `bc`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn

from labyrinth_core.pictures.renderer import DEFAULT_STYLE
from labyrinth_core.policies.networks.network import ACTIONS, as_input
from labyrinth_core.policies.networks.planning import PIXELS, on_grid, share_of
from labyrinth_core.policies.networks.symmetry import Averaged
from labyrinth_core.policies.spec import NetworkSpec
from pipeline.config.training import IMAGE_SIZE
from pipeline.training.methods import bc
from pipeline.training.methods.method import require_square, same_scale, setting
from pipeline.training.methods.planner import MAX_GRADIENT

SEEN = 32
"""The channels of the first convolution."""
INITIAL = 0.01
"""The standard deviation of initial weights, but for the first convolution and the last layer."""


@dataclass(frozen=True)
class Settings(bc.Settings):
    """An epoch is one pass over the demonstrations, or over `pictures` drawn from them."""

    epochs: int = 30
    evaluate_every: int = 5
    batch_size: int = 32
    learning_rate: float = 0.002
    iterations: int = setting(
        30,
        "K, the number of iterations of the module at the size that is trained on; in proportion "
        "to the side of others",
        at_least=1,
        at_most=1000,
    )
    reward_channels: int = setting(
        150,
        "hidden channels of the network of rewards (150 in the paper)",
        at_least=1,
        at_most=1024,
    )
    action_channels: int = setting(
        10,
        "channels of Q, over which the maximum is taken (10 in the paper)",
        at_least=1,
        at_most=1024,
    )


class ValueIteration(nn.Module):
    """The network of a value iteration network, from the picture to scores of the actions."""

    def __init__(
        self, side: int, settings: Settings, channels: int = 3, outputs: int = ACTIONS
    ) -> None:
        """Draw the weights.

        Args:
            side: The number of rows and columns of the labyrinths.
            settings: The settings of the method.
            channels: Those of what is seen.
            outputs: The number of scores.
        """
        super().__init__()
        self.side, self.iterations = side, settings.iterations
        # Strides of half a cell from the middle of the outer wall on: 2 n + 1 positions each way.
        self.see = nn.Conv2d(channels, SEEN, PIXELS // 2, stride=PIXELS // 2, padding=PIXELS // 4)
        self.hidden = nn.Conv2d(SEEN, settings.reward_channels, 3, padding=1)
        self.reward = nn.Conv2d(settings.reward_channels, 1, 1, bias=False)
        self.after_reward = nn.Conv2d(1, settings.action_channels, 3, padding=1, bias=False)
        self.after_value = nn.Conv2d(1, settings.action_channels, 3, padding=1, bias=False)
        self.choose = nn.Linear(settings.action_channels, outputs, bias=False)
        for layer in (self.hidden, self.reward, self.after_reward, self.after_value):
            nn.init.normal_(layer.weight, std=INITIAL)

    def forward(self, pictures: Tensor) -> Tensor:
        """Return the scores of the agent's actions, shape (N, 4)."""
        image = as_input(pictures)
        scene = on_grid(image, IMAGE_SIZE / self.side)
        cells = scene.shape[2] // PIXELS
        return self.attend(scene, share_of(image, DEFAULT_STYLE.agent, cells, cells))

    def attend(self, scene: Tensor, agent: Tensor) -> Tensor:
        """Return the scores where the agent is, shape (N, outputs).

        Args:
            scene: What is seen, with `PIXELS` places along a cell, shape (N, channels, side, side).
            agent: The share of the agent that is in each cell, shape (N, rows, columns).
        """
        reward = self.reward(self.hidden(self.see(scene).relu()))
        values = rewarded = self.after_reward(reward)  # V is nothing at first.
        for _ in range(1, round(self.iterations * agent.shape[1] / self.side)):
            values = rewarded + self.after_value(values.max(1, keepdim=True).values)
        attended = (values[:, :, 1::2, 1::2] * agent[:, None]).sum((2, 3))
        scores: Tensor = self.choose(attended)
        return scores


class Method(bc.Method):
    """The policy and its optimizer."""

    max_gradient = MAX_GRADIENT
    own_network = True

    @classmethod
    def make(cls, spec: NetworkSpec, settings: Any) -> nn.Module:
        require_square("method=vin", spec.height, spec.width)
        network = ValueIteration(spec.height, settings)
        return Averaged(network) if settings.average else network

    @classmethod
    def image_size(cls, spec: NetworkSpec, settings: Any, height: int, width: int) -> int:  # noqa: ARG003
        """Return as many pixels for each cell as the network was trained with."""
        require_square("method=vin", height, width)
        return same_scale(spec, height, width)
