"""The pictures of a labyrinth's states as PNG files, with the digests of their pixels."""

from __future__ import annotations

from collections.abc import Sequence

from labyrinth_core.pictures.png import PICTURE_SIZE, Mosaic, PictureDigest
from labyrinth_core.pictures.renderer import Painter
from labyrinth_core.world import Labyrinth, State

REMEMBERED_BYTES = 32 << 20
"""The size of the cache of a labyrinth's pictures; it holds 1,200 at 100x100."""


class StatePictures(dict[State, tuple[bytes, bytes]]):
    """A cache of the pictures of a labyrinth's states, each drawn when it is first needed.

    A value is the PNG file and the digest of its pixels: see `PictureDigest`.
    """

    def __init__(self, labyrinth: Labyrinth) -> None:
        super().__init__()
        self._painter = Painter(labyrinth)
        strips = self._painter.strips()
        self._mosaic, self._digests = Mosaic(strips, PICTURE_SIZE), PictureDigest(strips)

    def __missing__(self, state: State) -> tuple[bytes, bytes]:
        (png,), (digest,) = self.draw([state])
        if len(self) * len(png) >= REMEMBERED_BYTES:
            self.clear()
        self[state] = png, digest
        return png, digest

    def draw(self, states: Sequence[State]) -> tuple[Sequence[bytes], Sequence[bytes]]:
        """Return the PNG files and the digests of states, without keeping them."""
        changes = list(map(self._painter.changes, states))
        return list(map(self._mosaic.encode, changes)), list(map(self._digests.digest, changes))
