"""Pictures as files, for formats whose columns hold PNG."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray


def image_value(picture: NDArray[np.uint8]) -> dict[str, bytes | None]:
    """Return a picture, shape (height, width, 3), as `datasets` keeps one: a PNG file."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(picture).save(file, "PNG")
    return {"bytes": file.getvalue(), "path": None}
