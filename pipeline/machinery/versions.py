"""The software that makes datasets."""

from __future__ import annotations

import zlib
from importlib.metadata import version

import numpy as np

from labyrinth_core.pictures import ENCODER
from labyrinth_core.version import __version__


def build_versions() -> dict[str, str]:
    """Return the versions of the software that determines the bytes of a dataset."""
    return {
        "labyrinth-datasets": __version__,
        "numpy": np.__version__,
        "pyarrow": version("pyarrow"),
        "zlib": zlib.ZLIB_RUNTIME_VERSION,
        "png": ENCODER,
    }
