"""Closed-form controllers for two of Gymnasium's classic control tasks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

PUSH_LEFT, PUSH_RIGHT = 0, 2

_GRAVITY, _FORCE = 0.0025, 0.001
"""A step of MountainCar-v0 adds `push * force - gravity * cos(3 position)` to the velocity."""
_SUMMIT = math.acos(_FORCE / _GRAVITY) / 3
"""The position of the greatest potential under a constant push to the right."""
_MARGIN = 6e-4
"""Extra energy, because the motion is in discrete steps; 4e-4 to 1e-3 work as well."""
_ONE_SWING = -0.4875
"""A car that starts to the right of this position needs only one swing to the left."""


def balance_the_pole(observation: NDArray[np.float64]) -> int:
    """Return the push that keeps the pole of CartPole-v1 up and the cart on the track.

    It is the sign of a linear feedback: the pole's angle and, to look ahead, its angular velocity,
    with a little of the cart's position and velocity against drift. The push goes to the side to
    which the pole is about to fall, slightly sooner if the cart is on that side, too.

    Args:
        observation: Position, velocity, angle, angular velocity.
    """
    position, velocity, angle, turning = observation
    return int(angle + 0.5 * turning + 0.05 * position + 0.1 * velocity > 0)


def climb_the_mountain(observation: NDArray[np.float64]) -> int:
    """Return the push that drives the car of MountainCar-v0 up: swing until the energy suffices.

    Under a constant push to the right, `velocity^2 / 2 + potential(position)` is constant, so the
    car gets over the summit if this energy exceeds the potential there. Until then it is pushed in
    the direction of its motion, which adds the most energy; at rest, to the left if one swing
    suffices.

    Args:
        observation: Position, velocity.
    """
    position, velocity = observation
    energy = velocity**2 / 2 + _potential(position)
    if energy >= _potential(_SUMMIT) + _MARGIN or (velocity > 0 and position > _SUMMIT):
        return PUSH_RIGHT
    if velocity == 0:
        return PUSH_LEFT if position > _ONE_SWING else PUSH_RIGHT
    return PUSH_RIGHT if velocity > 0 else PUSH_LEFT


def _potential(position: float) -> float:
    """Return the potential energy of the car under a constant push to the right."""
    return _GRAVITY / 3 * math.sin(3 * position) - _FORCE * position
