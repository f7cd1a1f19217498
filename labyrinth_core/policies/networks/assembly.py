"""The network of a policy, put together."""

from __future__ import annotations

from torch import nn

from labyrinth_core.data.loader import DEFAULT_IMAGE_SIZE
from labyrinth_core.policies.networks.network import Network
from labyrinth_core.policies.networks.planning import Planner, PlannerSettings
from labyrinth_core.policies.networks.symmetry import Averaged
from labyrinth_core.policies.spec import NetworkSpec


def make_network(
    spec: NetworkSpec, *, average: bool = False, planner: PlannerSettings | None = None
) -> nn.Module:
    """Return a policy's network with fresh weights.

    Args:
        spec: Its shape; of a planner, the size of the labyrinths that it is trained on.
        average: Whether it is averaged over the symmetries of the picture when it acts.
        planner: The settings of a planner; None for a network with an encoder.
    """
    network: nn.Module
    if planner is None:
        network = Network(spec)
    else:
        network = Planner(DEFAULT_IMAGE_SIZE / max(spec.height, spec.width), planner)
    return Averaged(network) if average else network
