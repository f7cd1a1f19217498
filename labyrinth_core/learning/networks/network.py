"""The networks of the benchmark (supplement, Tables 1 and 2).

All take observations as stored, and scale them internally: pictures as uint8, shape
(batch, size, size, channels); vectors as integers, shape (batch, length).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import torch
from torch import Tensor, nn
from torch.nn import functional

from labyrinth_core.learning.spec import NetworkSpec
from labyrinth_core.world import Action, Task

ACTIONS = len(Action)
SLOPE = 0.01
DROPOUT = 0.3
MOMENTUM = 0.1
"""The momentum of the running statistics of batch normalisation."""
WIDTH = 512
"""The width of every classifier's hidden layers (Table 1)."""


@contextmanager
def usual_defaults() -> Iterator[None]:
    """Make new tensors float32 and on the CPU, whatever defaults another library has set."""
    dtype = torch.get_default_dtype()
    with ExitStack() as stack:
        stack.callback(torch.set_default_dtype, dtype)
        torch.set_default_dtype(torch.float32)
        if torch.get_default_device().type != "cpu":  # The context slows each call of PyTorch.
            stack.enter_context(torch.device("cpu"))
        yield


class Cnn(nn.Sequential):
    """The encoder of Table 1a, from Deep Q-Networks: 64 x 64 pixels to 1024 features."""

    features = 1024
    """4 x 4 positions with 64 channels."""

    def __init__(self, channels: int = 3) -> None:
        super().__init__(
            nn.Conv2d(channels, 32, 8, stride=4),
            nn.LeakyReLU(SLOPE),
            nn.Conv2d(32, 64, 4, stride=2),
            nn.BatchNorm2d(64, momentum=MOMENTUM),
            nn.LeakyReLU(SLOPE),
            nn.Conv2d(64, 64, 3),
            nn.BatchNorm2d(64, momentum=MOMENTUM),
            nn.LeakyReLU(SLOPE),
            nn.Flatten(),
        )


class Block(nn.Module):
    """The basic block of ResNet-18 (He et al. 2016, figure 2): two convolutions and a shortcut."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.straight = nn.Sequential(
            nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1, bias=False),
            nn.BatchNorm2d(outputs, momentum=MOMENTUM),
            nn.ReLU(),
            nn.Conv2d(outputs, outputs, 3, padding=1, bias=False),
            nn.BatchNorm2d(outputs, momentum=MOMENTUM),
        )
        self.past: nn.Module = nn.Identity()
        if stride != 1 or inputs != outputs:
            self.past = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride=stride, bias=False),
                nn.BatchNorm2d(outputs, momentum=MOMENTUM),
            )

    def forward(self, x: Tensor) -> Tensor:
        """Return the features after the block."""
        return functional.relu(self.straight(x) + self.past(x))


class ResNet18(nn.Sequential):
    """The encoder of Table 1b: pictures of any size to 512 features.

    The table's four blocks are the four stages of PyTorch's implementation, which the supplement
    says it follows: two basic blocks each, of 64, 128, 256 and 512 channels, then the mean over
    all positions. Weights are initialised as there. The first pooling has stride 1 as in the table,
    not 2 as in PyTorch.
    """

    features = 512

    def __init__(self, channels: int = 3) -> None:
        blocks = [(64, 64, 1), (64, 64, 1), (64, 128, 2), (128, 128, 1)]
        blocks += [(128, 256, 2), (256, 256, 1), (256, 512, 2), (512, 512, 1)]
        super().__init__(
            nn.Conv2d(channels, 64, 7, stride=2, padding=3, bias=False),
            nn.BatchNorm2d(64, momentum=MOMENTUM),
            nn.ReLU(),
            nn.MaxPool2d(3, stride=1, padding=1),
            *(Block(*shape) for shape in blocks),
            nn.AdaptiveAvgPool2d(1),
            nn.Flatten(),
        )
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")


class Mlp(nn.Module):
    """Our encoder for vectors, which are not in the supplement: 512 features.

    The wall grid is used directly; positions are one-hot, since they are indices.
    """

    features = WIDTH

    def __init__(self, spec: NetworkSpec, frames: int = 1) -> None:
        super().__init__()
        self.tiles = Task(spec.task).rules.positions
        self.grid = (2 * spec.height - 1) * (2 * spec.width - 1)
        inputs = frames * (self.tiles * (self.grid + 1) + self.grid)
        self.layer = nn.Linear(inputs, WIDTH)

    def forward(self, vectors: Tensor) -> Tensor:
        """Return the features of vectors, each of which concatenates all frames."""
        frames = vectors.long().reshape(len(vectors), -1, self.tiles + self.grid)
        # -1 stands for a key or a door that is gone.
        places = functional.one_hot(frames[:, :, : self.tiles] + 1, self.grid + 1)
        walls = frames[:, :, self.tiles :]
        inputs = torch.cat([places.flatten(1), walls.flatten(1)], 1).float()
        return functional.leaky_relu(self.layer(inputs), SLOPE)


def as_input(observations: Tensor) -> Tensor:
    """Return the input of an encoder: pictures scaled to [0, 1], channels first; or plain vectors.

    Pictures keep their layout in memory (channels last), which is the fastest for convolutions.
    """
    if observations.dtype == torch.uint8:
        return observations.permute(0, 3, 1, 2).float().div_(255)
    return observations


class Network(nn.Module):
    """An encoder and the classifier of Table 1: layers 9 to 15 for the CNN, 12 to 18 for ResNet.

    With `frames=2` it sees a state and its successor, concatenated along the last axis: the inverse
    dynamics model of BCO and IUPE.
    """

    def __init__(self, spec: NetworkSpec, outputs: int = ACTIONS, frames: int = 1) -> None:
        super().__init__()
        self.encoder: Cnn | ResNet18 | Mlp
        if spec.encoder == "mlp":
            self.encoder = Mlp(spec, frames)
        elif spec.encoder == "resnet18":
            self.encoder = ResNet18(3 * frames)
        else:
            self.encoder = Cnn(3 * frames)
        self.classifier = nn.Sequential(
            nn.Linear(self.encoder.features, WIDTH),
            nn.LeakyReLU(SLOPE),
            nn.Dropout(DROPOUT),
            nn.Linear(WIDTH, WIDTH),
            nn.LeakyReLU(SLOPE),
            nn.Dropout(DROPOUT),
            nn.Linear(WIDTH, outputs),
        )

    def forward(self, observations: Tensor) -> Tensor:
        """Return the outputs, shape (batch, outputs)."""
        outputs: Tensor = self.classifier[-1](self.hidden(observations))
        return outputs

    def hidden(self, observations: Tensor) -> Tensor:
        """Return the input of the last layer, shape (batch, WIDTH)."""
        features: Tensor = self.classifier[:-1](self.encoder(as_input(observations)))
        return features


def double(tensor: Tensor) -> Tensor:
    """Return a tensor in double precision, on the CPU if its device (Apple's GPUs) has none."""
    return (tensor.cpu() if tensor.device.type == "mps" else tensor).double()
