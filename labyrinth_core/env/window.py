"""A window that shows pictures and reads keys. Importing this module needs pygame."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

# Set before the import, or pygame prints a greeting.
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import pygame

from labyrinth_core.world import Action

MEANING_OF_KEY = {
    pygame.K_UP: Action.UP,
    pygame.K_RIGHT: Action.RIGHT,
    pygame.K_DOWN: Action.DOWN,
    pygame.K_LEFT: Action.LEFT,
    pygame.K_r: None,
}
QUIT_KEYS = (pygame.K_q, pygame.K_ESCAPE)


class Window:
    """A window with one picture in it."""

    def __init__(self) -> None:
        pygame.display.init()
        self._clock = pygame.time.Clock()

    def show(self, picture: NDArray[np.uint8], caption: str, fps: int | None = None) -> None:
        """Show a picture, shape (side, side, 3), rows from the top; at most `fps` per second."""
        surface = pygame.surfarray.make_surface(picture.transpose(1, 0, 2))
        screen = pygame.display.get_surface()
        if screen is None or screen.get_size() != surface.get_size():
            screen = pygame.display.set_mode(surface.get_size())
        screen.blit(surface, (0, 0))
        pygame.display.set_caption(caption)
        pygame.event.pump()
        pygame.display.flip()
        if fps is not None:
            self._clock.tick(fps)

    def pressed(self) -> Iterator[Action | None]:
        """Yield the meaning of each key pressed, until Q, Escape or the window is closed.

        An arrow key yields its action; R, for a new episode, yields None.
        """
        while (event := pygame.event.wait()).type != pygame.QUIT:
            if event.type == pygame.KEYDOWN:
                if event.key in QUIT_KEYS:
                    return
                if event.key in MEANING_OF_KEY:
                    yield MEANING_OF_KEY[event.key]

    def close(self) -> None:
        """Close the window."""
        pygame.display.quit()
