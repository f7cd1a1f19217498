"""Run a script with a stub of torchvision, for a client that uses only `ToTensor` of it.

    python torchvision_stand_in.py SCRIPT ARGUMENTS

The real package would install a torch with gigabytes for GPUs. IL-Datasets uses only `ToTensor` to
read data; the stub's other names can be imported, but do nothing.
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
    """Like torchvision's: turns a picture (height, width, 3) into (3, height, width), 0 to 1."""

    def __call__(self, picture: Any) -> torch.Tensor:
        """Return the tensor, float32."""
        return torch.from_numpy(np.array(picture)).permute(2, 0, 1).contiguous().float() / 255


def empty_class(name: str) -> type:
    """Return an empty class for a name that is imported, but not used."""
    if name.startswith("__"):
        raise AttributeError(name)
    return type(name, (), {})


def install() -> None:
    """Make `import torchvision` return the stub."""
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
