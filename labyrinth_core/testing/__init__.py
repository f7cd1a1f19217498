"""Check that a policy, or a method of learning, keeps the promises that the library relies on.

    from labyrinth_core.testing import check_method, check_policy

    check_policy(policy)  # docs/evaluation.md, "Policy interface"
    check_method(Method)  # docs/new-method.md, "Rules"

Each promise is an assertion, whose message is a sentence. The checks sample small labyrinths; they
need no dataset. `check_method` needs PyTorch.
"""

from __future__ import annotations

from typing import Any

from labyrinth_core.evaluation import check_policy as check_policy
from labyrinth_core.world import Task

__all__ = ["check_method", "check_policy"]


def check_method(
    method: Any,
    settings: Any = None,
    *,
    height: int = 3,
    width: int = 3,
    task: str = Task.NAVIGATION,
) -> None:
    """Check that a method of learning keeps its promises; see `methods`.

    Args:
        method: The class, which inherits from `Learner`.
        settings: An object of its `Settings`; None for their defaults, with two epochs.
        height: Rows of the labyrinths to learn from.
        width: Columns of these labyrinths.
        task: The task of these labyrinths.

    Raises:
        AssertionError: A promise is broken; the message says which.
    """
    from labyrinth_core.testing.methods import check_method as check

    check(method, settings, height, width, Task(task))
