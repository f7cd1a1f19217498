"""Check that a method of learning keeps the promises that the training loop relies on."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from inspect import isabstract, isclass
from math import isfinite
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.optim import Optimizer

from labyrinth_core.evaluation import check_policy
from labyrinth_core.learning import BaseSettings, Learner, NetworkSpec, Problem
from labyrinth_core.pictures import PICTURE_SIZE
from labyrinth_core.world import Solver, Task, sample_labyrinth

LABYRINTHS = 8
"""The number of labyrinths that a method is tried on."""

SAVED = "networks, optimizers, NumPy arrays and numbers"


def check_method(
    method: Any,
    settings: Any = None,
    *,
    height: int = 3,
    width: int = 3,
    task: str = Task.NAVIGATION,
) -> None:
    """Check that a method of learning keeps its promises.

    Args:
        method: The class, which inherits from `Learner`.
        settings: An object of its `Settings`; None for their defaults, with two epochs.
        height: Rows of the labyrinths to learn from.
        width: Columns of these labyrinths.
        task: The task of these labyrinths.

    Raises:
        AssertionError: A promise is broken; the message says which.
    """
    assert isclass(method), "A method is a class."
    assert issubclass(method, Learner), "A method inherits from labyrinth_core.learning.Learner."
    assert not isabstract(method), "A method has a function epoch(self)."
    declared = method.settings_class()
    assert isclass(declared), "Settings is a class."
    assert issubclass(declared, BaseSettings), "Settings inherits from BaseSettings."
    assert is_dataclass(declared), "Settings is a dataclass."
    assert "__dataclass_fields__" in vars(declared), "Settings is a dataclass of its own."
    for each in fields(declared):
        assert "checks" in each.metadata, f"The setting {each.name} is declared with setting(...)."
    settings = replace(declared(), epochs=2) if settings is None else settings
    learner, again = (_trained(method, settings, height, width, Task(task)) for _ in range(2))
    same = all(
        torch.equal(one, other)
        for one, other in zip(
            learner.policy.state_dict().values(), again.policy.state_dict().values(), strict=True
        )
    )
    assert same, "The same seed gives the same weights: draw from self.problem.rng."
    spec = learner.problem.spec
    size = method.image_size(spec, settings, height, width)
    assert 1 <= size <= PICTURE_SIZE, f"image_size is a number of pixels, 1 to {PICTURE_SIZE}."
    training = learner.policy.training
    policy = method.player(learner.acting, spec, settings)
    check_policy(policy, height=height, width=width, task=task, image_size=size)
    assert learner.policy.training == training, "Acting restores the mode of the network."


def _trained(method: Any, settings: Any, height: int, width: int, task: Task) -> Learner:
    """Return a method after two epochs, having checked what each returns and changes."""
    learner: Learner = method(_problem(method, settings, height, width, task), settings)
    problem = learner.problem
    before = [each.copy() for each in (problem.arrays.next_state, *problem.demonstrations)]
    for _ in range(2):
        figures = learner.epoch()
        numbers = isinstance(figures, dict) and {name: float(figures[name]) for name in figures}
        assert numbers, "epoch returns a dictionary of numbers."
        assert "loss" in numbers, "epoch returns the loss, as in {'loss': 0.5}."
        assert all(map(isfinite, numbers.values())), "What epoch returns is finite."
        for name, value in vars(learner).items():
            kept = (nn.Module, Optimizer, np.ndarray, int, float)
            if name not in ("problem", "settings"):
                assert isinstance(value, kept), f"Attributes are {SAVED}: {name} is not."
    after = (learner.problem.arrays.next_state, *learner.problem.demonstrations)
    unchanged = all(map(np.array_equal, before, after))
    assert unchanged, "A method does not change what self.problem holds."
    assert isinstance(learner.policy, nn.Module), "self.policy is a PyTorch module."
    return learner


def _problem(method: Any, settings: Any, height: int, width: int, task: Task) -> Problem:
    """Return a small problem: a few labyrinths, with a demonstration each."""
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    sampled = {sample_labyrinth(height, width, task, rng) for _ in range(4 * LABYRINTHS)}
    labyrinths = sorted(sampled, key=str)[:LABYRINTHS]
    routes = [np.array(Solver(each).shortest_route(rng), np.int64) for each in labyrinths]
    module = method.__module__.rpartition(".")[2]
    encoder = module if module in NetworkSpec.OWN else "cnn"
    spec = NetworkSpec(encoder, height, width, str(task))
    size = method.image_size(spec, settings, height, width)
    return Problem.of_labyrinths(labyrinths, routes, size, spec)
