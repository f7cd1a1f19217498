"""A network of your own, trained on demonstrations with plain PyTorch, and evaluated.

    labyrinth-datasets size=5 && python examples/plain_pytorch.py

Needs, in a clone: pip install '.[train]'
"""

import torch
from torch import nn
from torch.utils.data import BatchSampler, DataLoader, RandomSampler

from labyrinth_core import Dataset, evaluate
from labyrinth_core.evaluation import Results


class Network(nn.Module):
    """Pictures, uint8 of shape (B, 64, 64, 3), to scores of the four actions."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            *(nn.Conv2d(3, 32, 8, stride=4), nn.ReLU(), nn.Conv2d(32, 64, 4, stride=2), nn.ReLU()),
            *(nn.Flatten(), nn.Linear(64 * 6 * 6, 256), nn.ReLU(), nn.Linear(256, 4)),
        )

    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        """Return the scores, shape (B, 4)."""
        scores: torch.Tensor = self.layers(pictures.permute(0, 3, 1, 2) / 255)
        return scores


def main(folder: str = "data/labyrinth", config: str = "5x5", epochs: int = 100) -> Results:
    """Train on the demonstrations of train, and evaluate on all splits."""
    torch.manual_seed(0)
    data = Dataset(folder, config)
    transitions = data["train"].transitions()
    batches = BatchSampler(RandomSampler(transitions), batch_size=64, drop_last=False)
    loader = DataLoader(transitions, batch_size=None, sampler=batches)
    network = Network()
    optimizer = torch.optim.Adam(network.parameters(), lr=5e-4)
    for _ in range(epochs):
        for pictures, actions, _ in loader:
            loss = nn.functional.cross_entropy(network(pictures), actions)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    return evaluate(network, data)


if __name__ == "__main__":
    results = main()
    print(results)
    results.save("results/plain-pytorch.json", name="BC in plain PyTorch")
