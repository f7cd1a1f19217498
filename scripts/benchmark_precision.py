"""Measure whether `precision=bf16` pays on this machine: a gradient step in both precisions.

    python scripts/benchmark_precision.py [--encoder cnn] [--batch 64] [--rounds 5]

The two take turns, so that a busy machine slows both alike. Prints the median CPU seconds of each
on one thread, and the median of the rounds' ratios. Above 1, bfloat16 is faster.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median

import torch
from measuring import machine, parser_of, ratio, take_turns
from torch.nn import functional

from labyrinth_core.policies.networks.network import ACTIONS, Network
from labyrinth_core.policies.spec import NetworkSpec
from pipeline.config.training import IMAGE_SIZE, PRECISIONS


def step_of(encoder: str, batch: int, precision: str) -> Callable[[], float]:
    """Return a function that takes a gradient step and returns its CPU seconds."""
    torch.manual_seed(0)
    network = Network(NetworkSpec(encoder, 1, 5, 5, "navigation"))
    optimizer = torch.optim.Adam(network.parameters())
    pictures = torch.randint(0, 256, (batch, IMAGE_SIZE, IMAGE_SIZE, 3), dtype=torch.uint8)
    labels = torch.randint(0, ACTIONS, (batch,))

    def step() -> float:
        began = time.process_time()
        with torch.autocast("cpu", torch.bfloat16, precision == "bf16", cache_enabled=False):
            loss = functional.cross_entropy(network(pictures), labels)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        return time.process_time() - began

    return step


def main() -> None:
    """Measure and print."""
    parser = parser_of(__doc__, rounds=5)
    parser.add_argument("--encoder", default="resnet18", choices=["cnn", "resnet18"])
    parser.add_argument("--batch", type=int, default=64)
    given = parser.parse_args()
    torch.set_num_threads(1)
    contestants = {name: step_of(given.encoder, given.batch, name) for name in PRECISIONS}
    taken = take_turns(contestants, 1 if given.quick else given.rounds)
    print(f"{machine('torch')}; {torch.backends.cpu.get_cpu_capability()}; one thread")
    print(f"{given.encoder}, {given.batch} pictures, CPU seconds of a step:", end="")
    print(*(f" {name} {median(seconds):.3f}" for name, seconds in taken.items()), sep=",")
    middle, spread = ratio(taken["fp32"], taken["bf16"])
    print(f"fp32 / bf16: {middle} ({spread})")


if __name__ == "__main__":
    main()
