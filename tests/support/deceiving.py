"""Environments of seeds whose levels are known, and some that deceive who counts them."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np


class Corridor(gymnasium.Env[Any, Any]):
    """Shows its level, `seed % levels`, and the position of an agent that walks to the right.

    Subclasses override what makes the level, or what is seen of it.
    """

    levels = 10
    hidden = 0
    """The step until which the level is not seen."""
    length = 1_000
    action_space = gymnasium.spaces.Discrete(2)
    observation_space = gymnasium.spaces.Box(0, 1_000, (2,), np.int64)

    def __init__(self) -> None:
        self.level = self.position = self.steps = 0

    def level_of(self, seed: int) -> int:
        return seed % self.levels

    def goal_of(self, level: int) -> int:
        return 3 + level

    def look(self) -> Any:
        return np.array([self.level if self.steps >= self.hidden else 0, self.position])

    def reset(self, *, seed: int | None = None, **_: Any) -> tuple[Any, dict[str, Any]]:
        self.level = self.level_of(0 if seed is None else seed)
        self.position = self.steps = 0
        return self.look(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        self.position += int(action)
        goal = self.position == self.goal_of(self.level)
        return self.look(), float(goal), goal, self.steps >= self.length, {}


class GlobalRandom(Corridor):
    def level_of(self, _: int) -> int:
        return random.randrange(self.levels) + int(np.random.randint(2))  # noqa: NPY002


class HashSeed(Corridor):
    def level_of(self, seed: int) -> int:
        return hash(f"level {seed}") % 1_000


class SeedIgnored(Corridor):
    def level_of(self, _: int) -> int:
        return int(np.random.default_rng().integers(1 << 30))


class FixedAtConstruction(Corridor):
    def __init__(self) -> None:
        super().__init__()
        self.fixed = int(np.random.default_rng().integers(1 << 30))

    def level_of(self, _: int) -> int:
        return self.fixed


class OverwrittenInPlace(Corridor):
    """Returns the same array each time."""

    def __init__(self) -> None:
        super().__init__()
        self.seen = np.zeros(2, np.int64)

    def look(self) -> Any:
        self.seen[:] = super().look()
        return self.seen


class History(Corridor):
    """Its levels become harder with the episodes played."""

    def __init__(self) -> None:
        super().__init__()
        self.played = 0

    def level_of(self, seed: int) -> int:
        self.played += 1
        return seed % self.levels + self.played // 20


class SecondReset(Corridor):
    """A second reset gives another world."""

    def __init__(self) -> None:
        super().__init__()
        self.resets = 0

    def level_of(self, seed: int) -> int:
        self.resets += 1
        return 1_000 * self.resets + seed % self.levels


class DictOrder(Corridor):
    """The order of the keys of its observation is another one each time."""

    def look(self) -> Any:
        parts = list({"level": self.level, "position": self.position, "more": "text"}.items())
        random.Random(time.perf_counter_ns()).shuffle(parts)
        return dict(parts)


class NotANumber(Corridor):
    def look(self) -> Any:
        return np.array([np.nan, -0.0 if self.steps % 2 else 0.0, self.level, self.position])


class Objects(Corridor):
    """Its observations are arrays of objects, new ones each time."""

    def look(self) -> Any:
        seen = np.empty(2, object)
        seen[:] = [f"level {self.level}", {"position": [self.position]}]
        return seen


class FailsAtTimes(Corridor):
    def level_of(self, seed: int) -> int:
        if seed % 50 == 7:
            raise ValueError(f"no level {seed}")
        return super().level_of(seed)


class Clock(Corridor):
    def look(self) -> Any:
        return {"level": self.level, "time": time.time()}


class StepsDiffer(Corridor):
    """As Crafter: first observations repeat, steps do not."""

    def look(self) -> Any:
        return np.array([self.level, self.steps and int(np.random.default_rng().integers(2**40))])


class Late(Corridor):
    """Its level is seen after 100 steps."""

    hidden = 101

    def goal_of(self, level: int) -> int:
        return self.length + level


class SharedBuffer(Corridor):
    """Its observation is a view of an array that all instances write."""

    shared = np.zeros((3, 2), np.int64)

    def look(self) -> Any:
        self.shared[1] = super().look()
        return self.shared[1]


class SeedInInfo(Corridor):
    def reset(self, *, seed: int | None = None, **_: Any) -> tuple[Any, dict[str, Any]]:
        return super().reset(seed=seed)[0], {"seed": seed, "time": time.time()}


class BytesInMemory(Corridor):
    """Its observation is a new view of bytes each time."""

    def look(self) -> Any:
        return memoryview(super().look().tobytes())


class SecondType(Corridor):
    """The observations after a second reset have another type."""

    resets = 0

    def level_of(self, seed: int) -> int:
        self.resets += 1
        return super().level_of(seed)

    def look(self) -> Any:
        return super().look().astype(np.int64 if self.resets == 1 else np.int32)


class LateClock(Corridor):
    """Reads a clock after 20 steps."""

    def look(self) -> Any:
        return np.append(super().look(), time.time_ns() if self.steps > 20 else 0)


class SpaceOfSeed(Corridor):
    """The seed chooses which actions there are."""

    action_space = gymnasium.spaces.Discrete(4)

    def level_of(self, seed: int) -> int:
        self.action_space = gymnasium.spaces.Discrete(2 + seed % 3)
        return super().level_of(seed)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        if not self.action_space.contains(action):
            raise ValueError(f"no action {action}")
        return super().step(action)


class Unreadable:
    """As a tensor that needs a gradient."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("use detach() first")


DECEIVERS: dict[Callable[[], Any], str] = {
    GlobalRandom: "it draws from the global random state",
    HashSeed: "it depends on PYTHONHASHSEED",
    SeedIgnored: "it ignores the seed",
    FixedAtConstruction: "its levels are fixed when the environment is made",
    OverwrittenInPlace: "",
    History: "its levels depend on what was played before",
    DictOrder: "",
    NotANumber: "",
    Objects: "",
    FailsAtTimes: "",
    Clock: "it reads a clock",
    SecondReset: "its levels depend on what was played before",
    SharedBuffer: "",
    SeedInInfo: "",
    BytesInMemory: "",
    SecondType: "its levels depend on what was played before",
}
"""Environment -> what is said of it; nothing is said of those whose seeds mean something."""
