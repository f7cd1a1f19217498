"""Observations of states: pictures (decoded or drawn), vectors or texts."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.episodes import Episodes
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.language.drawing import describe
from labyrinth_core.pictures.png import PICTURE_SIZE, strips_of
from labyrinth_core.pictures.resize import area_average, shrink
from labyrinth_core.pictures.scenes import DRAWN_BYTES, draw, draw_many
from labyrinth_core.pictures.vector import vector_observation, vector_observations
from labyrinth_core.world.dynamics import State, state_at
from labyrinth_core.world.labyrinth import Labyrinth, whole

OBSERVATIONS = ("image", "vector", "text")

RESIZES = {
    "area": (None, "area"),
    "original": (2, "bilinear"),
}
"""`resize` option -> wall thickness in pixels (None: the look's) and one of `resize.RESIZES`.

`original` is for comparison: walls are two pixels thick and are not antialiased, as in the authors'
pictures, so that most walls vanish at 64 x 64. These pictures are always drawn, since the walls in
`obs` are thicker and would not vanish.
"""

PICTURES_VERSION = 1
"""Version of how pictures are decoded, drawn and resized, part of the frame cache's key.

Increase it with any change of a pixel.
"""

HELD_BYTES = 2**30
"""Above this many bytes, pictures of all states of a split are not held, but drawn when indexed."""

CACHED_BYTES = 64 * 2**20
"""The bytes that the cache of decoded pictures may take."""


@dataclass(frozen=True)
class ObservationSpec:
    """How states are observed."""

    observation: str
    """One of `OBSERVATIONS`."""
    image_size: int
    """Pixels on each side of a picture."""
    draw: bool = False
    """Whether pictures are drawn from `info` and `actions`, instead of decoded from `obs`."""
    resize: str = "area"
    """One of `RESIZES`."""

    def __post_init__(self) -> None:
        if self.observation not in OBSERVATIONS:
            allowed = ", ".join(OBSERVATIONS)
            raise ValueError(f"observation={self.observation}: choose one of {allowed}")
        size = whole("image_size", self.image_size, 1, PICTURE_SIZE)
        object.__setattr__(self, "image_size", size)
        if self.resize not in RESIZES:
            raise ValueError(f"resize={self.resize}: choose one of {', '.join(RESIZES)}")

    @property
    def decodes(self) -> bool:
        """Whether the pictures in `obs` are needed."""
        return self.observation == "image" and not self.draw and self.resize == "area"

    @property
    def together(self) -> int:
        """Rows observed in one batch: their pictures take 8 MB, about a processor's cache."""
        return max(1, DRAWN_BYTES // (3 * self.image_size**2))

    def observe(
        self, episodes: Episodes, pictures: NDArray[np.uint8] | None = None
    ) -> NDArray[Any]:
        """Return the observation in each row of episodes, shape (n, ...).

        Args:
            episodes: The episodes, n rows of them.
            pictures: Output array, shape (n, image_size, image_size, 3); None for a new one.

        Raises:
            DatasetError: A picture is missing or cannot be decoded.
        """
        labyrinths, which, states = episodes.labyrinths, episodes.which, episodes.states
        pngs = episodes.whole.rows.pngs
        if self.decodes:
            assert pngs is not None
            decode = _remembering_decoder(self.image_size)
            return np.stack([decode(png) for png in pngs], out=pictures)
        if self.observation == "vector":
            return vector_observations(labyrinths, which, states)
        if self.observation == "image" and self.image_size != PICTURE_SIZE:
            wall_pixels, resize = RESIZES[self.resize]
            size = self.image_size
            return draw_many(
                labyrinths,
                which,
                states,
                size,
                wall_pixels=wall_pixels,
                resize=resize,
                out=pictures,
            )
        parsed = episodes.parsed()
        seen = zip(which.tolist(), states.tolist(), strict=True)
        looks = self.look([(parsed[n], state_at(parsed[n], state)) for n, state in seen])
        if pictures is None:
            return looks
        pictures[:] = looks
        return pictures

    def look(self, views: Sequence[tuple[Labyrinth, State]]) -> NDArray[Any]:
        """Return the observations of (labyrinth, state) pairs; pictures are drawn in batches."""
        if self.observation == "text":
            return np.array([describe(labyrinth, state) for labyrinth, state in views])
        if self.observation == "vector":
            return np.stack([vector_observation(labyrinth, state) for labyrinth, state in views])
        wall_pixels, resize = RESIZES[self.resize]
        return draw(views, self.image_size, wall_pixels=wall_pixels, resize=resize)

    def look_later(
        self, views: Sequence[tuple[Labyrinth, State]], held_bytes: int = HELD_BYTES
    ) -> NDArray[Any] | Looks:
        """Return the observations, or lazy `Looks` if the pictures exceed `held_bytes`."""
        large = self.observation == "image" and len(views) * 3 * self.image_size**2 > held_bytes
        return Looks(self, views) if large else self.look(views)


class Looks:
    """Observations of states, made anew each time they are indexed."""

    def __init__(self, spec: ObservationSpec, views: Sequence[tuple[Labyrinth, State]]) -> None:
        self._spec, self._views = spec, views

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self._views)

    def __getitem__(self, states: NDArray[np.int64]) -> NDArray[Any]:
        """Return the observations of some states, shape (states, ...)."""
        return self._spec.look([self._views[state] for state in states.tolist()])


@lru_cache(maxsize=1)
def _remembering_decoder(image_size: int) -> Callable[[bytes | None], NDArray[np.uint8]]:
    """Return a cached `_decode`, since a random policy revisits states.

    A repeated picture costs 0.2 us instead of 50.
    """
    pictures = max(1, CACHED_BYTES // (3 * image_size**2))
    return lru_cache(maxsize=pictures)(partial(_decode, image_size=image_size))


def _decode(png: bytes | None, image_size: int) -> NDArray[np.uint8]:
    """Return an area-averaged picture, shape (image_size, image_size, 3)."""
    if png is None:
        raise DatasetError("obs: a row has no picture")
    strips = strips_of(png, PICTURE_SIZE)
    if strips is not None:
        return shrink(strips, image_size)
    from PIL import Image  # For pictures of other encoders.

    try:
        with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
            # Checked before anything is decompressed, since the picture may claim to be huge.
            if image.size != (PICTURE_SIZE, PICTURE_SIZE):
                width, height = image.size
                raise ValueError(f"it has {width} x {height} pixels, not {PICTURE_SIZE} each way")
            return area_average(np.asarray(image.convert("RGB")), image_size)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise DatasetError(f"obs: a picture cannot be decoded: {one_line(error)}") from error
