"""Read a file of weights in the safetensors format, which cannot hold code."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from labyrinth_core.errors import MALFORMED, one_line

if TYPE_CHECKING:
    from torch import Tensor


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Return the tensors in a file, on the CPU, and the texts in its header.

    The file is read, not mapped into memory, which some network file systems do not support.

    Raises:
        OSError: The file does not exist, or cannot be read.
        ValueError: The file has another format.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    content = path.read_bytes()
    try:
        tensors = load(content)
        header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
    except (SafetensorError, RuntimeError, *MALFORMED) as error:
        raise ValueError(one_line(error)) from error
    return tensors, header.get("__metadata__") or {}
