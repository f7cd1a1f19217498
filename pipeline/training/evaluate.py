"""Evaluation: one greedy episode for every labyrinth of a split."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pipeline.training.following import follow, greedy_actions
from pipeline.training.worlds import Worlds

if TYPE_CHECKING:
    from pipeline.training.policy import Policy


def success_rate(policy: Policy, worlds: Worlds) -> float:
    """Return the share of labyrinths that a greedy episode of a policy solves."""
    return float(follow(worlds, greedy_actions(policy, worlds)).solved.mean())
