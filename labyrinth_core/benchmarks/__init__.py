"""Anyone's benchmark: how many levels its seeds give, and how many levels of test are in train.

`certify` looks at an environment from outside, by `reset(seed=)` and fixed actions.
"""

from labyrinth_core.benchmarks.certificate import Certificate
from labyrinth_core.benchmarks.certification import certify
from labyrinth_core.benchmarks.encoding import encode
from labyrinth_core.benchmarks.environment import CertifyError
from labyrinth_core.benchmarks.levels import Levels, Share, Spread, wilson
from labyrinth_core.benchmarks.memory import Memory

__all__ = [
    "Certificate",
    "CertifyError",
    "Levels",
    "Memory",
    "Share",
    "Spread",
    "certify",
    "encode",
    "wilson",
]
