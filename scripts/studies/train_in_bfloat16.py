"""Run the program as `run.py` does, but compute ResNet-18 in bfloat16.

    python scripts/studies/train_in_bfloat16.py size=3 stages=train method=bco encoder=resnet18

Training then takes 0.4 times as long on a CPU with AMX (docs/studies/results.md). Weights,
gradients and the classifier stay float32: Q-values and PPO's ratios need its digits. Files do not
record the precision, so `run_queue.py` keeps the results in a folder of their own.
"""

from __future__ import annotations

import sys

import torch
from torch import Tensor

from labyrinth_core.policies.networks.network import ResNet18
from pipeline.__main__ import main

in_float32 = ResNet18.forward


def in_bfloat16(encoder: ResNet18, pictures: Tensor) -> Tensor:
    """Return the features of pictures, as `ResNet18.forward`."""
    with torch.autocast(pictures.device.type, torch.bfloat16):
        return in_float32(encoder, pictures).float()


if __name__ == "__main__":
    ResNet18.forward = in_bfloat16  # type: ignore[method-assign]
    sys.exit(main())
