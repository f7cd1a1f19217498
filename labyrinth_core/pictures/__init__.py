"""Draw states as images, and encode them as vectors; both are exact to the last bit.

Many states are drawn together, from the parts of a picture that they share.
"""

from typing import TYPE_CHECKING

from labyrinth_core.doors import door

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from labyrinth_core.pictures.animation import animate as animate
    from labyrinth_core.pictures.observations import OBSERVATIONS as OBSERVATIONS
    from labyrinth_core.pictures.observations import RESIZES as RESIZES
    from labyrinth_core.pictures.observations import Looks as Looks
    from labyrinth_core.pictures.observations import ObservationSpec as ObservationSpec
    from labyrinth_core.pictures.observations import PictureError as PictureError
    from labyrinth_core.pictures.png import DEFAULT_IMAGE_SIZE as DEFAULT_IMAGE_SIZE
    from labyrinth_core.pictures.png import ENCODER as ENCODER
    from labyrinth_core.pictures.png import PICTURE_SIZE as PICTURE_SIZE
    from labyrinth_core.pictures.png import PictureDigest as PictureDigest
    from labyrinth_core.pictures.renderer import Painter as Painter
    from labyrinth_core.pictures.renderer import StatePictures as StatePictures
    from labyrinth_core.pictures.renderer import render as render
    from labyrinth_core.pictures.scenes import Gallery as Gallery
    from labyrinth_core.pictures.style import COLOURS_IN_WORDS as COLOURS_IN_WORDS
    from labyrinth_core.pictures.style import DEFAULT_STYLE as DEFAULT_STYLE
    from labyrinth_core.pictures.style import MAX_PICTURED_SIDE as MAX_PICTURED_SIDE
    from labyrinth_core.pictures.style import Colour as Colour
    from labyrinth_core.pictures.style import usual_wall_pixels as usual_wall_pixels
    from labyrinth_core.pictures.vector import VectorLayout as VectorLayout
else:
    __getattr__, __dir__ = door(
        __name__,
        {
            "animation": ("animate",),
            "observations": (
                "Looks",
                "OBSERVATIONS",
                "ObservationSpec",
                "PictureError",
                "RESIZES",
            ),
            "png": ("DEFAULT_IMAGE_SIZE", "ENCODER", "PICTURE_SIZE", "PictureDigest"),
            "renderer": ("Painter", "StatePictures", "render"),
            "scenes": ("Gallery",),
            "style": (
                "COLOURS_IN_WORDS",
                "Colour",
                "DEFAULT_STYLE",
                "MAX_PICTURED_SIDE",
                "usual_wall_pixels",
            ),
            "vector": ("VectorLayout",),
        },
    )
