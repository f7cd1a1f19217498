"""A classifier of walls with a breadth-first search on top: no imitation, but a control for it.

The classifier is a small convolutional network which sees the pixels around a passage between two
cells, and says whether there is a wall. It learns from the transitions (s, a, s') of the splits
train and random: the agent moved, so that the passage is open; or it stayed, so that there is a
wall. What is learnt of a passage in one state is a label in all pictures of the labyrinth, since
walls stay. Whether an action was an expert's or a random one makes no difference.

The rest is built in: the number of pixels of a cell and the colours of agent and goal, which are
read; which action leads where; that a wall between columns looks as one between rows does in the
transposed picture; and the search. A passage with a predicted wall costs more than any way round,
so that the way with the fewest predicted walls is taken if no way is free.

It works for navigation only, where nothing but walls stops an agent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from labyrinth_core.pictures.renderer import DEFAULT_STYLE
from labyrinth_core.policies.networks.network import as_input
from labyrinth_core.policies.networks.planning import FAR, PIXELS, on_grid, path_costs, share_of
from labyrinth_core.policies.spec import NetworkSpec
from labyrinth_core.world.labyrinth import Task
from pipeline.config.errors import check
from pipeline.config.training import IMAGE_SIZE
from pipeline.training.methods.acting import Steps
from pipeline.training.methods.method import (
    BaseSettings,
    Learner,
    Problem,
    require_square,
    same_scale,
    setting,
)

UNKNOWN = -1


@dataclass(frozen=True)
class Settings(BaseSettings):
    """An epoch is `pictures` pictures of states that an episode visits."""

    epochs: int = 10
    evaluate_every: int = 1
    batch_size: int = 32
    learning_rate: float = 0.001
    pictures: int = setting(1024, "number of pictures in an epoch", at_least=1)
    channels: int = setting(16, "number of channels of the classifier", at_least=1, at_most=1024)


class Walls(nn.Module):
    """The classifier of walls, and the search."""

    def __init__(self, side: int, channels: int) -> None:
        """Draw the weights; `side` is the number of rows and columns of the labyrinths."""
        super().__init__()
        self.side = side
        self.classifier = nn.Sequential(
            nn.Conv2d(3, channels, PIXELS // 4, stride=PIXELS // 4),
            nn.ReLU(),
            nn.Conv2d(channels, channels, 4, stride=4),
            nn.ReLU(),
            nn.Conv2d(channels, 1, 1),
        )

    def forward(self, pictures: Tensor) -> Tensor:
        """Return the scores of the agent's actions, shape (N, 4)."""
        image = as_input(pictures)
        walls = self.walls(image) > 0
        side = walls.shape[2]
        end = FAR * (1 - self._where(image, DEFAULT_STYLE.goal, side))
        step = torch.where(walls, float(side * side), 1.0)
        paths = path_costs(torch.cat([step, end[:, None]], 1), side * side, rest=True)
        agent = self._where(image, DEFAULT_STYLE.agent, side).flatten(1).argmax(1)
        return -paths.flatten(2)[torch.arange(len(paths)), :, agent]

    def walls(self, image: Tensor) -> Tensor:
        """Return the logits that each action in each cell is stopped, (N, 4, rows, columns).

        Args:
            image: Pictures as `as_input` returns them.
        """
        image = on_grid(image, IMAGE_SIZE / self.side)
        rows, columns = self._between_rows(image), self._between_rows(image.transpose(2, 3))
        columns = columns.transpose(1, 2)
        sides = (rows[:, :-1], columns[:, :, 1:], rows[:, 1:], columns[:, :, :-1])
        return torch.stack(sides, 1)

    def _between_rows(self, image: Tensor) -> Tensor:
        """Return the logits of walls above and below the rows, (N, rows + 1, columns)."""
        half = PIXELS // 2
        logits: Tensor = self.classifier(functional.pad(image, (0, 0, half, half)))
        return logits[:, 0]

    @staticmethod
    def _where(image: Tensor, colour: tuple[int, int, int], side: int) -> Tensor:
        """Return 1 in the cell with most of a colour, and 0 in all others, (N, side, side)."""
        share = share_of(image, colour, side, side).flatten(1)
        return functional.one_hot(share.argmax(1), side * side).float().view(-1, side, side)


class Method(Learner):
    """The classifier, its optimizer, and what is known of the walls."""

    policy: Walls
    own_network = True

    def __init__(self, problem: Problem, settings: Any) -> None:
        super().__init__(problem, settings)
        steps = Steps(
            *map(np.concatenate, zip(problem.demonstrations, problem.exploration(), strict=True))
        )
        self.visited = np.unique(steps.states)
        self.known = _known(problem, steps)

    @classmethod
    def make(cls, spec: NetworkSpec, settings: Any) -> nn.Module:
        require_square("method=walls", spec.height, spec.width)
        check(
            spec.task == Task.NAVIGATION,
            f"task={spec.task}: method=walls searches for the goal of task=navigation only",
        )
        return Walls(spec.height, settings.channels)

    @classmethod
    def image_size(cls, spec: NetworkSpec, settings: Any, height: int, width: int) -> int:  # noqa: ARG003
        """Return as many pixels for each cell as the classifier was trained with."""
        require_square("method=walls", height, width)
        return same_scale(spec, height, width)

    def epoch(self) -> dict[str, float]:
        losses: list[float] = []
        right = labelled = 0
        self.policy.train()
        for batch in self.batches(self.settings.pictures):
            states = self.problem.rng.choice(self.visited, len(batch))
            labels = self.tensor(self.known[self.problem.arrays.labyrinth[states]])
            known = labels != UNKNOWN
            logits = self.policy.walls(as_input(self.see(states)))[known]
            labels = labels[known]
            loss = functional.binary_cross_entropy_with_logits(logits, labels.float())
            self.descend(self.optimizer, loss)
            losses.append(loss.item())
            right += int(((logits > 0) == (labels > 0)).sum())
            labelled += len(labels)
        return {"loss": sum(losses) / len(losses), "accuracy": right / labelled}


def _known(problem: Problem, steps: Steps) -> NDArray[np.int64]:
    """Return 1 where steps have shown a wall, 0 an open passage, else `UNKNOWN`.

    The shape is (L, 4, rows, columns), rows from the top. A passage has a label on both sides.
    """
    arrays, spec = problem.arrays, problem.spec
    known = np.full((len(arrays.initial), 4, spec.height * spec.width), UNKNOWN)
    states, actions, after = steps
    labyrinth, stayed = arrays.labyrinth[states], states == after
    known[labyrinth, actions, arrays.position[states]] = stayed
    moved = ~stayed
    known[labyrinth[moved], (actions[moved] + 2) % 4, arrays.position[after[moved]]] = 0
    return np.ascontiguousarray(known.reshape(-1, 4, spec.height, spec.width)[:, :, ::-1])
