"""Check that a policy, or a method of learning, keeps the promises that the library relies on.

    from labyrinth_core.testing import check_method, check_policy

    check_policy(policy)  # docs/evaluation.md, "Policy interface"
    check_method(Method)  # docs/new-method.md, "Rules"

Each promise is an assertion, whose message is a sentence. The checks sample small labyrinths; they
need no dataset. `check_method` needs PyTorch.
"""

from typing import TYPE_CHECKING

from labyrinth_core.doors import door
from labyrinth_core.evaluation import check_policy as check_policy

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from labyrinth_core.testing.methods import check_method as check_method
else:
    __getattr__, __dir__ = door(__name__, {"methods": ("check_method",)})
