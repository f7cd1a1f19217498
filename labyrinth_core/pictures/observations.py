"""How an agent can observe a state: as a picture (decoded or drawn), a vector or a text.

Loading, evaluation and environments read `KINDS`, so a kind is declared here alone. `Looks` holds
the observations of many states, or makes them when they are indexed.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.language import describe
from labyrinth_core.pictures.png import DEFAULT_IMAGE_SIZE, PICTURE_SIZE, strips_of
from labyrinth_core.pictures.resize import area_average, shrink
from labyrinth_core.pictures.scenes import DRAWN_BYTES, DRAWN_CELLS, KeptScenes, draw, draw_many
from labyrinth_core.pictures.style import style_for
from labyrinth_core.pictures.vector import (
    VectorLayout,
    vector_observation,
    vector_observations,
)
from labyrinth_core.world import Labyrinth, Labyrinths, Look, State, Task

Numbers = NDArray[np.int64]


class Kind(NamedTuple):
    """A kind of observation that is a function of the state alone."""

    of: Callable[[Labyrinth, State], Any]
    """Returns the observation of a state."""
    of_many: Callable[[Labyrinths, Numbers, Numbers], NDArray[Any]] | None = None
    """Returns the same for N states, faster, given labyrinths, the index of each state's labyrinth
    and the index of each state; None makes them one by one."""
    bounds: Callable[[VectorLayout], tuple[NDArray[Any], NDArray[Any]]] | None = None
    """Returns the least and the greatest value of each entry; None if environments do not offer
    this kind."""


KINDS = {
    "vector": Kind(vector_observation, vector_observations, VectorLayout.bounds),
    "text": Kind(describe),
}
"""Name -> kind. Pictures, which also depend on options, are drawn by `scenes`."""

OBSERVATIONS = ("image", *KINDS)

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

Increase it with any change of a pixel, except by other colours, which are part of the key.
"""

CACHED_BYTES = 64 * 2**20
"""The bytes that the cache of decoded pictures may take."""

HELD_BYTES = 2**30
"""Above this many bytes, observations of all states are not held, but made when indexed."""

KEPT_BYTES = 2**28
"""Above this many bytes, the scenes of pictures that are drawn when indexed are not kept either."""


class PictureError(ValueError):
    """A stored picture is missing, or cannot be decoded."""


@dataclass(frozen=True)
class ObservationSpec:
    """How states are observed."""

    observation: str
    """One of `OBSERVATIONS`."""
    image_size: int = DEFAULT_IMAGE_SIZE
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

    def bounds(self, height: int, width: int, task: Task) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the least and the greatest value of each entry, if `is_bounded`."""
        if self.observation == "image":
            shape = self.image_size, self.image_size, 3
            return np.zeros(shape, np.uint8), np.full(shape, 255, np.uint8)
        bounds = KINDS[self.observation].bounds
        assert bounds is not None
        return bounds(VectorLayout(height, width, task))

    @property
    def is_bounded(self) -> bool:
        """Whether the observation is an array with bounds, as environments need."""
        return self.observation == "image" or KINDS[self.observation].bounds is not None

    @property
    def key(self) -> tuple[Any, ...]:
        """What determines the pixels of a picture, besides its size, the state and `obs`."""
        styles = () if self.decodes else tuple(style_for(look, 5, 5) for look in Look)
        return self.draw, self.resize, PICTURES_VERSION, *styles

    @property
    def decodes(self) -> bool:
        """Whether the pictures in `obs` are needed."""
        return self.observation == "image" and not self.draw and self.resize == "area"

    @property
    def together(self) -> int:
        """Rows observed in one batch: their pictures take 8 MB, about a processor's cache."""
        return max(1, DRAWN_BYTES // (3 * self.image_size**2))

    def memory(self, rows: int) -> NDArray[np.uint8]:
        """Return an array for the pictures of a batch, shape (rows, image_size, image_size, 3).

        Batches differ in size by an episode. Their memory has one size, so that a batch is written
        where one before it was: else the system clears new pages, a quarter of a short epoch.
        """
        size = self.image_size
        capacity = max(rows, self.together * 9 // 8)
        return np.empty((capacity, size, size, 3), np.uint8)[:rows]

    def decoded(
        self, pngs: Iterable[bytes | None], pictures: NDArray[np.uint8] | None = None
    ) -> NDArray[np.uint8]:
        """Return stored pictures at this size, shape (n, image_size, image_size, 3).

        Args:
            pngs: The picture of each state, as `png.encode` or another encoder wrote it.
            pictures: Output array; None for a new one.

        Raises:
            PictureError: A picture is missing or cannot be decoded.
        """
        decode = _remembering_decoder(self.image_size)
        return np.stack([decode(png) for png in pngs], out=pictures)

    @property
    def of_arrays(self) -> bool:
        """Whether `look_together` makes the observations: not, say, pictures of full size."""
        if self.observation == "image":
            return self.image_size != PICTURE_SIZE
        return KINDS[self.observation].of_many is not None

    def look_together(
        self,
        labyrinths: Labyrinths,
        which: NDArray[np.int64],
        states: NDArray[np.int64],
        pictures: NDArray[np.uint8] | None = None,
    ) -> NDArray[Any]:
        """Return the observations of N states, given as arrays, shape (N, ...).

        Args:
            labyrinths: The labyrinths.
            which: The index of each state's labyrinth, shape (N,).
            states: The index of each state, as in `Labyrinth.state_index`, shape (N,).
            pictures: Output array, shape (N, image_size, image_size, 3); None for a new one.
        """
        if self.observation != "image":
            of_many = KINDS[self.observation].of_many
            assert of_many is not None
            return of_many(labyrinths, which, states)
        wall_pixels, resize = RESIZES[self.resize]
        size = self.image_size
        return draw_many(
            labyrinths, which, states, size, wall_pixels=wall_pixels, resize=resize, out=pictures
        )

    def look(self, views: Sequence[tuple[Labyrinth, State]]) -> NDArray[Any]:
        """Return the observations of (labyrinth, state) pairs; pictures are drawn in batches."""
        if self.observation != "image":
            return np.array([KINDS[self.observation].of(*view) for view in views])
        wall_pixels, resize = RESIZES[self.resize]
        return draw(views, self.image_size, wall_pixels=wall_pixels, resize=resize)


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
        raise PictureError("a row has no picture")
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
        reason = str(error) or type(error).__name__
        raise PictureError(f"a picture cannot be decoded: {reason}") from error


class Looks:
    """Observations of states, made from the labyrinths each time they are indexed."""

    def __init__(
        self,
        spec: ObservationSpec,
        labyrinths: Sequence[Labyrinth],
        which: NDArray[np.int64],
        states: NDArray[np.int64],
    ) -> None:
        """Collect the labyrinths of each look, which are drawn together.

        Args:
            spec: How the states are observed.
            labyrinths: One or more labyrinths of one size and task.
            which: The index of each state's labyrinth, shape (S,).
            states: The index of each state in it, as in `Labyrinth.state_index`, shape (S,).
        """
        self._spec, self._labyrinths = spec, labyrinths
        self._which, self._states = which, states
        self._scenes: dict[int, KeptScenes] = {}
        looks: dict[Look, list[int]] = {}
        for number, each in enumerate(labyrinths if spec.of_arrays else []):
            looks.setdefault(each.look, []).append(number)
        self._group, self._offset = np.zeros((2, len(labyrinths)), np.int64)
        for group, numbers in enumerate(looks.values()):
            self._group[numbers], self._offset[numbers] = group, range(len(numbers))
        self._alike = [
            Labyrinths.of([labyrinths[number] for number in numbers]) for numbers in looks.values()
        ]

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self._states)

    def __getitem__(self, chosen: NDArray[np.int64]) -> NDArray[Any]:
        """Return the observations of N states, shape (N, ...)."""
        which, states = self._which[chosen], self._states[chosen]
        if not self._alike:
            pairs = zip(which.tolist(), states.tolist(), strict=True)
            parsed = self._labyrinths
            return self._spec.look([(parsed[n], parsed[n].state_at(state)) for n, state in pairs])
        group, offset = self._group[which], self._offset[which]
        parts = []
        for number, alike in enumerate(self._alike):
            rows = np.flatnonzero(group == number)
            if self._keeps:
                seen = self._kept(number).draw(offset[rows], states[rows])
            else:
                # Only the labyrinths that are shown: drawing takes time for each that it is given.
                used, own = np.unique(offset[rows], return_inverse=True)
                seen = self._spec.look_together(alike.take(used), own, states[rows])
            parts.append((rows, seen))
        if len(parts) == 1:
            return seen
        observations = np.empty((len(states), *seen.shape[1:]), seen.dtype)
        for rows, seen in parts:
            observations[rows] = seen
        return observations

    @cached_property
    def _keeps(self) -> bool:
        """Whether the scenes of all labyrinths are kept once they are drawn."""
        task = self._alike[0].task
        if self._spec.observation != "image" or task.rules.hides:
            return False
        wall_pixels, resize = RESIZES[self._spec.resize]
        needed = sum(
            KeptScenes.memory_of(
                alike, self._spec.image_size, wall_pixels=wall_pixels, resize=resize
            )
            for alike in self._alike
        )
        return needed <= KEPT_BYTES

    def _kept(self, number: int) -> KeptScenes:
        """Return the scenes of the labyrinths of a look, which are drawn when first requested."""
        if number not in self._scenes:
            wall_pixels, resize = RESIZES[self._spec.resize]
            self._scenes[number] = KeptScenes(
                self._alike[number],
                self._spec.image_size,
                wall_pixels=wall_pixels,
                resize=resize,
            )
        return self._scenes[number]

    def held(self) -> NDArray[Any] | Looks:
        """Return all observations as an array, or this object if they exceed `HELD_BYTES`."""
        count, numbers = len(self), np.arange(len(self))
        if count * self[numbers[:1]].nbytes > HELD_BYTES:
            return self
        if not self._alike:
            return self[numbers]
        cells = self._alike[0].ground.shape[1]
        together = max(1, min(self._spec.together, DRAWN_CELLS // cells))
        first = self[numbers[:together]]
        observations = np.empty((count, *first.shape[1:]), first.dtype)
        for begin in range(0, count, together):
            observations[begin : begin + together] = self[numbers[begin : begin + together]]
        return observations
