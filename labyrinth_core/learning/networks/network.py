"""The networks of the benchmark (supplement, Tables 1 and 2), and the symmetries of their input.

All take observations as stored, and scale them internally: pictures as uint8, shape
(batch, size, size, channels); vectors as integers, shape (batch, length).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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

SYMMETRIES = range(8)
"""Of the square: 0 to 3 are quarter turns to the left; 4 to 7 are the same, then mirrored."""


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


class Discriminator(nn.Module):
    """GAIL's discriminator (Table 2): features and the one-hot action, 1028 inputs, to a logit.

    It has an encoder of its own: the CNN without batch normalisation or, for vectors, which the
    source does not have, `Mlp`.
    """

    def __init__(self, spec: NetworkSpec) -> None:
        super().__init__()
        self.encoder: nn.Module
        if spec.encoder == "mlp":
            self.encoder, features = Mlp(spec), Mlp.features
        else:
            layers = [layer for layer in Cnn() if not isinstance(layer, nn.BatchNorm2d)]
            self.encoder, features = nn.Sequential(*layers), Cnn.features
        self.classifier = nn.Sequential(
            nn.Linear(features + ACTIONS, 256),
            nn.LeakyReLU(SLOPE),
            nn.Linear(256, 256),
            nn.LeakyReLU(SLOPE),
            nn.Linear(256, 1),
        )

    def forward(self, observations: Tensor) -> Tensor:
        """Return the logit that each (observation, action) is demonstrated, shape (batch, 4)."""
        features = self.encoder(as_input(observations)).repeat_interleave(ACTIONS, 0)
        actions = torch.eye(ACTIONS).to(features).repeat(len(observations), 1)
        logits: Tensor = self.classifier(torch.cat([features, actions], 1))
        return logits.view(-1, ACTIONS)


class ActorCritic(nn.Module):
    """A policy network with one more output, the value of the state.

    Args:
        policy: The network; the critic shares all of its layers but the last.
        unit: The unit of the values and of the critic's loss, which keeps that loss from
            outweighing the policy's.
    """

    def __init__(self, policy: Network, unit: float) -> None:
        super().__init__()
        self.unit = unit
        self.policy = policy
        self.value = nn.Linear(WIDTH, 1)

    def forward(self, observations: Tensor) -> Tensor:
        """Return the scores of the four actions, then the value, shape (batch, 5)."""
        hidden = self.policy.hidden(observations)
        last = self.policy.classifier[-1]
        return torch.cat([last(hidden), self.value(hidden) * self.unit], 1)


def transform(pictures: Tensor, symmetry: int) -> Tensor:
    """Return pictures, or maps of cells, transformed by a symmetry.

    Args:
        pictures: Shape (N, rows, columns, ...), rows from the top.
        symmetry: One of `SYMMETRIES`.
    """
    turned = torch.rot90(pictures, symmetry % 4, (1, 2))
    return turned.flip(2) if symmetry >= 4 else turned


def transformed_actions(symmetry: int) -> list[int]:
    """Return for each action the equivalent action in transformed pictures."""
    # A quarter turn to the left maps up to left: one less in the order up, right, down, left.
    quarters = [(action - symmetry) % 4 for action in range(4)]
    return [-action % 4 for action in quarters] if symmetry >= 4 else quarters


def transform_examples(pictures: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
    """Transform an eighth of the examples by each symmetry of the square; return all of them.

    Args:
        pictures: Shape (N, size, size, 3).
        labels: The action of each picture, or of each cell; -1 for none.
    """
    seen, turned = [], []
    for symmetry in SYMMETRIES:
        # The last entry maps -1, which stands for no label, to itself.
        actions = torch.tensor([*transformed_actions(symmetry), -1], device=labels.device)
        some = actions[labels[symmetry :: len(SYMMETRIES)]]
        seen.append(transform(pictures[symmetry :: len(SYMMETRIES)], symmetry))
        turned.append(transform(some, symmetry) if some.dim() == 3 else some)
    return torch.cat(seen), torch.cat(turned)


class Averaged(nn.Module):
    """A network whose outputs in evaluation mode are averaged over the symmetries of its input.

    The averaged outputs are mean log-probabilities of the actions.
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network
        self.symmetries: Sequence[int] = SYMMETRIES
        """The symmetries to average over; fewer take less time."""

    def forward(self, pictures: Tensor) -> Tensor:
        """Return scores of the four actions, shape (N, 4)."""
        if self.training:
            scores: Tensor = self.network(pictures)
            return scores
        views = [
            self.network(transform(pictures, each)).log_softmax(1)[:, transformed_actions(each)]
            for each in self.symmetries
        ]
        return torch.stack(views).mean(0)
