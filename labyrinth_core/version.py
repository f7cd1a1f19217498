"""The version of the package, who makes it, and the software that determines bytes."""

from __future__ import annotations

__version__ = "0.1.0"

DEVELOPERS = "The Labyrinth datasets developers"
"""The makers of the program and of its datasets, as a name."""


def build_versions() -> dict[str, str]:
    """Return the versions of the software that determines the bytes of a dataset."""
    import zlib
    from importlib.metadata import version

    import numpy as np

    from labyrinth_core.pictures import ENCODER

    return {
        "labyrinth-datasets": __version__,
        "numpy": np.__version__,
        "pyarrow": version("pyarrow"),
        "zlib": zlib.ZLIB_RUNTIME_VERSION,
        "png": ENCODER,
    }
