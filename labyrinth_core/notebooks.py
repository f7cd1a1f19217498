"""In a notebook, a `Labyrinth` shows its picture."""

from __future__ import annotations

from typing import Any

WIDTH = 300
"""The width at which pictures are shown, in pixels; they have twice as many for sharp screens."""


def picture(labyrinth: Any) -> tuple[bytes, dict[str, int]]:
    """Return the picture of a `Labyrinth` as PNG, and the width at which to show it."""
    from labyrinth_core.pictures import Painter

    return Painter(labyrinth).png(labyrinth.initial), {"width": WIDTH}


def register(shell: Any) -> None:
    """Let a shell of IPython show labyrinths; `shell` is None outside of notebooks.

    The type is registered by its name, so that nothing is imported before a labyrinth is shown.
    `Labyrinth` itself cannot draw, since pictures are made from it.
    """
    if shell is not None:
        pictures = shell.display_formatter.formatters["image/png"]
        pictures.for_type_by_name("labyrinth_core.world.labyrinth", "Labyrinth", picture)
