"""`check_method` passes our methods and that of docs/new-method.md, and names a broken promise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from labyrinth_core.learning import Learner
from labyrinth_core.testing import check_method
from pipeline.config import TrainingOptions
from pipeline.training.identity import find

pytestmark = pytest.mark.slow  # Each method is trained for two epochs, twice.

LESS = {"epochs": 2, "epochs_a_round": 1, "model_epochs": 1, "updates": 5, "pictures": 16}


@pytest.mark.parametrize("name", TrainingOptions.METHODS)
def test_our_methods_keep_their_promises(name: str) -> None:
    torch.set_num_threads(1)
    known = vars(find(name, {})[1])
    method, settings = find(name, {key: value for key, value in LESS.items() if key in known})
    check_method(method, settings)


class Idle(Learner):
    """Learns nothing."""

    def epoch(self) -> dict[str, float]:
        return {"loss": 0.5}


class Silent(Idle):
    def epoch(self) -> dict[str, float]:
        return {"error": 0.5}


class Wordy(Idle):
    def epoch(self) -> Any:
        return "0.5"


class Endless(Idle):
    def epoch(self) -> dict[str, float]:
        return {"loss": float("nan")}


class Hoarding(Idle):
    def epoch(self) -> dict[str, float]:
        self.seen = [1, 2]
        return {"loss": 0.5}


class Unkeyed(Idle):
    def epoch(self) -> dict[str, float]:
        with torch.no_grad():
            for each in self.policy.parameters():
                each += float(np.random.default_rng().random())
        return {"loss": 0.5}


class Clumsy(Idle):
    def epoch(self) -> dict[str, float]:
        self.problem.demonstrations.actions[:] = 0
        return {"loss": 0.5}


class Forgetful(Idle):
    @classmethod
    def player(cls, policy: Any, spec: Any, settings: Any) -> Any:  # noqa: ARG003
        return lambda seen: np.full(len(seen), 7)


@pytest.mark.parametrize(
    ("method", "sentence"),
    [
        (object, "A method inherits from labyrinth_core.learning.Learner"),
        (Learner, "A method has a function epoch"),
        (Silent, "epoch returns the loss"),
        (Wordy, "epoch returns a dictionary of numbers"),
        (Endless, "What epoch returns is finite"),
        (Hoarding, "Attributes are networks, optimizers, NumPy arrays and numbers: seen is not"),
        (Unkeyed, "The same seed gives the same weights"),
        (Clumsy, r"A method does not change what self\.problem holds"),
        (Forgetful, "A function answers B observations with B actions"),
    ],
)
def test_a_broken_promise_is_named(method: Any, sentence: str) -> None:
    check_method(Idle)
    with pytest.raises(AssertionError, match=rf"\A{sentence}"):
        check_method(method)
