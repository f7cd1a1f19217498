"""The planner: learns the costs of steps from pictures, and plans with them.

Its network is in `labyrinth_core.learning.networks.planning`.

The planner builds on value iteration networks (Tamar et al. 2016), which plan inside a network that
is trained by imitation, and on value propagation (Nardelli et al. 2019), which learns where values
pass; on recurrent networks that are trained on small mazes and iterate longer on larger ones, with
tied weights and recall of the input (Schwarzschild et al. 2021; Bansal et al. 2022); on hindsight
relabelling (Andrychowicz et al. 2017); and on averaging over symmetries, which Cohen and Welling
(2016) build into the weights. The loss is that of behavioural cloning.

It learns from the demonstrations of the split train only, without steps of its own. But it has
prior knowledge that the other methods lack, so that it has to learn little more than what walls and
goal look like. Each part of this knowledge can be switched off:

- `augment`: transformed actions solve a transformed labyrinth (`transform_examples`). This also
  tells the planner how actions and directions correspond.
- `relabel`: a part of a route is a route, also in reverse, and can be drawn with a new start and
  goal in their usual colours (`ExampleSampler`).
- `average`: the policy's outputs are averaged over the eight symmetries of the picture.
- `path_prior`: a layer that computes shortest paths. It contains the dynamics: which action leads
  to which neighbour, and that the costs of steps add up. If two labels are exchanged, as if up led
  to the right, it cannot learn (docs/studies/generalisation.md). Without it, planning is an
  iterated gated convolution, which does not know what actions do.
- `sharpness`, with `path_prior` and `grid_prior`: costs are raised to this power when acting. The
  power is not learnt, and cannot be selected on validation: every power from 1 to 8 solves all of
  it. 3 was chosen on labyrinths of 10x10 and 25x25, which no other method saw; 1 has no effect.
- `grid_prior`: the number of pixels per cell, so that the internal grid has one position per cell,
  and cells of larger labyrinths are drawn with the same number of pixels.
- `colour_prior`: the agent's colour, which locates the agent. Without it, attention learns to find
  the agent. With both `grid_prior` and `colour_prior`, each picture of a state on a route teaches
  the actions of all states on the route.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn
from torch.nn import functional
from torch.optim import Adam

from labyrinth_core.evaluation import PolicyError
from labyrinth_core.learning.examples import NO_LABEL
from labyrinth_core.learning.methods import bc
from labyrinth_core.learning.networks.acting import make_network
from labyrinth_core.learning.networks.planning import Planner
from labyrinth_core.learning.spec import NetworkSpec, PlannerSpec
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE

RISE, FALL = 0.05, 0.5
"""The shares of training, at its start and end, in which the learning rate rises and falls."""


@dataclass(frozen=True)
class Settings(PlannerSpec, bc.Settings):
    """An epoch is `pictures` pictures; the learning rate rises at the start, falls at the end."""

    epochs: int = 30
    evaluate_every: int = 10
    batch_size: int = 32
    learning_rate: float = 0.004
    augment: bool = True
    relabel: bool = True
    average: bool = True
    path_prior: bool = True
    grid_prior: bool = True
    colour_prior: bool = True
    channels: int = 32
    iterations: int = 20
    sharpness: float = 3.0


class Method(bc.Method):
    """The policy; its optimizer counts the gradient steps, which set the learning rate."""

    max_gradient = 1.0  # With many iterations some gradients become large.

    @classmethod
    def make(cls, spec: NetworkSpec, settings: Any) -> nn.Module:
        _require_square(settings, spec.height, spec.width)
        try:
            settings.require_bounded(settings.average)
        except ValueError as error:
            raise PolicyError(f"method.{error}") from None
        return make_network(spec, average=settings.average, own=settings)

    @classmethod
    def image_size(cls, spec: NetworkSpec, settings: Any, height: int, width: int) -> int:
        """Return the picture size with as many pixels per cell as in training."""
        _require_square(settings, height, width)
        return round(DEFAULT_IMAGE_SIZE * max(height, width) / max(spec.height, spec.width))

    def epoch(self) -> dict[str, float]:
        whole = self.settings.grid_prior and self.settings.colour_prior
        return {"loss": self.learn_drawn(whole=whole)}

    def loss(self, pictures: Tensor, labels: Tensor) -> Tensor:
        if labels.dim() == 1:
            return super().loss(pictures, labels)
        planner = next(each for each in self.policy.modules() if isinstance(each, Planner))
        return functional.cross_entropy(planner.plan(pictures), labels, ignore_index=NO_LABEL)

    def descend(self, optimizer: Adam, loss: Tensor) -> None:
        settings, first = self.settings, next(self.policy.parameters())
        an_epoch = -(-settings.pictures // settings.batch_size)
        epochs, steps = divmod(int(optimizer.state[first].get("step", 0)), an_epoch)
        over = (epochs + steps / an_epoch) / settings.epochs
        factor = min(1.0, (over + 1e-3) / RISE, (1 - over) / FALL)
        for group in optimizer.param_groups:
            group["lr"] = settings.learning_rate * factor
        super().descend(optimizer, loss)


def _require_square(settings: Any, height: int, width: int) -> None:
    if height != width and settings.grid_prior:
        raise PolicyError(
            f"size={height}x{width}: method.grid_prior=true needs as many rows as columns; give "
            "method.grid_prior=false"
        )
