"""Files of tensors in the safetensors format, which cannot contain code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.storage import write_bytes


def save_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: dict[str, str]) -> None:
    """Write tensors and texts into one file, atomically."""
    # Cloned because networks may share weights, which the format cannot express.
    owned = {name: tensor.detach().clone().contiguous() for name, tensor in tensors.items()}
    write_bytes(path, save(owned, metadata))


def load_tensors(
    path: Path, text: str, device: torch.device | str = "cpu"
) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Return the tensors of a file, and what one of its texts, named `text`, says in JSON.

    Raises:
        DatasetError: The file is not there, or cannot be read.
    """
    try:
        with safe_open(path, framework="pt", device=str(device)) as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            return tensors, json.loads((file.metadata() or {})[text])
    except FileNotFoundError as error:
        raise DatasetError(f"{path} is not there: stages=[train] makes it") from error
    except (OSError, SafetensorError, LookupError, ValueError) as error:
        reason = f"{path} cannot be read: {one_line(error)}"
        raise DatasetError(f"{reason}; remove it to begin anew with stages=[train]") from error
