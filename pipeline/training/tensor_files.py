"""Files of tensors, written all or nothing, in the format safetensors: no code is in them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from safetensors.torch import save
from torch import Tensor


def save_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: dict[str, str]) -> None:
    """Write tensors and texts into one file, through a temporary one."""
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        # Copies, since networks may share weights, and the format has no word for that.
        owned = {name: tensor.detach().clone().contiguous() for name, tensor in tensors.items()}
        temporary.write_bytes(save(owned, metadata))
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
