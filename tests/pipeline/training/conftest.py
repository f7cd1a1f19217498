"""The fixtures of tests that train, for the tests of this folder."""

from __future__ import annotations

from support.learning import problem_of, require_reproducible

__all__ = ["problem_of", "require_reproducible"]
