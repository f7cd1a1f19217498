"""The version of the package, and who makes it."""

from __future__ import annotations

__version__ = "0.1.0"

DEVELOPERS = "The Labyrinth datasets developers"
"""The makers of the program and of its datasets, as a name."""
