"""A stand-in for torchvision, for a client that imports it and needs no more of it than `ToTensor`.

    python torchvision_stand_in.py SCRIPT ARGUMENTS

runs a script with it. The package of that name brings a torch with gigabytes for GPUs. IL-Datasets
uses `ToTensor` alone to read data; the rest are names that can be imported.
"""

from __future__ import annotations

import runpy
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

import numpy as np
import torch


class ToTensor:
    """As in torchvision: a picture (height, width, 3) becomes (3, height, width), from 0 to 1."""

    def __call__(self, picture: Any) -> torch.Tensor:
        """Return the tensor, float32."""
        return torch.from_numpy(np.array(picture)).permute(2, 0, 1).contiguous().float() / 255


def empty_class(name: str) -> type:
    """Return an empty class for a name that is imported and not used."""
    if name.startswith("__"):
        raise AttributeError(name)
    return type(name, (), {})


def install() -> None:
    """Let `import torchvision` find the stand-in."""
    parents: dict[str, ModuleType] = {}
    for name in (
        "torchvision",
        "torchvision.io",
        "torchvision.models",
        "torchvision.transforms",
        "torchvision.transforms.functional",
        "torchvision.transforms.v2",
        "torchvision.transforms.v2.functional",
    ):
        module = ModuleType(name)
        module.__path__ = []
        module.__spec__ = ModuleSpec(name, None, is_package=True)
        module.__getattr__ = empty_class  # type: ignore[method-assign]
        sys.modules[name] = parents[name] = module
        above, _, own = name.rpartition(".")
        if above:
            setattr(parents[above], own, module)
    parents["torchvision.transforms"].ToTensor = ToTensor  # type: ignore[attr-defined]


if __name__ == "__main__":
    install()
    del sys.argv[0]
    runpy.run_path(sys.argv[0], run_name="__main__")
