"""A policy that remembers: a GRU that learns from whole episodes under partial observability.

    labyrinth-datasets size=5 task=partial_observability && python examples/recurrent_policy.py

Needs, in a clone: pip install '.[train]'
"""

import numpy as np
import torch
from torch import nn
from torch.nn.utils.rnn import pad_sequence

from labyrinth_core import evaluate, load_episodes
from labyrinth_core.evaluation import Results


class Recurrent(nn.Module):
    """Vectors to scores of the four actions, with a memory of all vectors before."""

    def __init__(self, length: int, width: int = 256) -> None:
        super().__init__()
        self.places = nn.Embedding(length, 16)  # Of agent, start and goal, which are numbers.
        self.gru = nn.GRU(3 * 16 + length - 3, width, batch_first=True)
        self.last = nn.Linear(width, 4)

    def see(self, vectors: torch.Tensor) -> torch.Tensor:
        """Return what goes into the memory, shape (count, steps, inputs)."""
        return torch.cat([self.places(vectors[..., :3]).flatten(2), vectors[..., 3:]], dim=2)

    def reset(self, count: int) -> None:
        """Begin `count` episodes with an empty memory."""
        self.memory = torch.zeros(1, count, self.gru.hidden_size)

    @torch.no_grad()
    def act(self, observations: np.ndarray) -> torch.Tensor:
        """Return the scores in one step of all episodes, shape (count, 4)."""
        found, self.memory = self.gru(self.see(torch.tensor(observations)[:, None]), self.memory)
        return self.last(found[:, 0])


def main(folder="data/labyrinth", config="5x5-partial_observability", epochs=200) -> Results:
    """Train on the demonstrations of train, and evaluate on all splits."""
    torch.manual_seed(0)
    episodes = list(load_episodes(folder, config, split="train", observation="vector"))
    seen = pad_sequence([torch.tensor(e.observations[:-1]) for e in episodes], batch_first=True)
    wanted = pad_sequence([torch.tensor(e.actions) for e in episodes], True, -100)  # Not counted.
    policy = Recurrent(seen.shape[2])
    optimizer = torch.optim.Adam(policy.parameters(), lr=2e-3)
    for _ in range(epochs):
        scores = policy.last(policy.gru(policy.see(seen))[0])
        loss = nn.functional.cross_entropy(scores.transpose(1, 2), wanted)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return evaluate(policy, folder, config, observation="vector")


if __name__ == "__main__":
    print(main())
