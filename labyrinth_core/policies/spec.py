"""What a policy's network is made from, in plain types: `config.json`, beside its weights.

The file is data. Each value in it is checked against what is allowed, and nothing in it is run.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, TypeVar

from labyrinth_core.data.loader import DEFAULT_IMAGE_SIZE
from labyrinth_core.world.grid import MAX_SIDE, MIN_SIDE
from labyrinth_core.world.labyrinth import Task

CONFIG = "config.json"
WEIGHTS = "model.safetensors"
"""The names of the two files of a policy."""

KIND = "labyrinth-policy"
FORMAT = 1

PLANNER = "planner"
"""The encoder of a policy that is a `Planner`, which has no other one."""


@dataclass(frozen=True)
class NetworkSpec:
    """Everything that the shape of a policy's network depends on, but for that of a planner."""

    encoder: str
    """cnn, resnet18, mlp or planner."""
    pool_stride: int
    """The stride of ResNet-18's first pooling: 1 in Table 1, 2 in the original ResNet."""
    height: int
    """The height of the labyrinths in cells, on which the length of vectors depends."""
    width: int
    task: str


@dataclass(frozen=True)
class PlannerSpec:
    """What else the network of a planner depends on: settings of `method=planner`."""

    path_prior: bool
    grid_prior: bool
    colour_prior: bool
    channels: int
    iterations: int
    sharpness: float


@dataclass(frozen=True)
class PolicySpec:
    """What a policy's network is made from."""

    network: NetworkSpec
    average: bool
    """Whether it is averaged over the symmetries of the picture."""
    planner: PlannerSpec | None
    """None for all encoders but the planner."""

    @property
    def observation(self) -> str:
        """What the policy looks at: image or vector."""
        return "vector" if self.network.encoder == "mlp" else "image"

    @property
    def image_size(self) -> int | None:
        """Pixels on each side of the pictures that it was trained on; None for vectors."""
        return DEFAULT_IMAGE_SIZE if self.observation == "image" else None

    def to_json(self) -> dict[str, Any]:
        """Return the content of `config.json`."""
        return {
            "kind": KIND,
            "format": FORMAT,
            "observation": self.observation,
            "image_size": self.image_size,
            **asdict(self),
        }

    @classmethod
    def from_json(cls, content: Any) -> PolicySpec:
        """Return what the content of a `config.json` describes.

        Raises:
            ValueError: It is of another form, or a value is none of those allowed.
        """
        own = ("kind", "format", "observation", "image_size")
        _check_names("it", content, [*own, *(field.name for field in fields(cls))])
        planner = content["planner"]
        network = _read(NetworkSpec, content["network"], "network")
        _check("average", content["average"])
        spec = cls(
            network=network,
            average=content["average"],
            planner=None if planner is None else _read(PlannerSpec, planner, "planner"),
        )
        if (network.encoder == PLANNER) != (planner is not None):
            raise ValueError(f"encoder is {network.encoder!r}, and planner is {planner!r:.60}")
        for name, value in spec.to_json().items():
            if name in own and content[name] != value:
                raise ValueError(f"{name} is {content[name]!r:.60}, not {value!r}")
        return spec


_ALLOWED: Mapping[str, Iterable[Any]] = {
    "encoder": ("cnn", "resnet18", "mlp", PLANNER),
    "pool_stride": (1, 2),
    "height": range(MIN_SIDE, MAX_SIDE + 1),
    "width": range(MIN_SIDE, MAX_SIDE + 1),
    "task": tuple(map(str, Task)),
    "channels": range(1, 1025),
    "iterations": range(1, 1001),
}
"""The values of each name; other names have true or false, but for the sharpness."""

_MOST_SHARPNESS = 1_000.0

Spec = TypeVar("Spec", NetworkSpec, PlannerSpec)


def _read(cls: type[Spec], values: Any, place: str) -> Spec:
    _check_names(place, values, [field.name for field in fields(cls)])
    for name, value in values.items():
        _check(f"{place}.{name}", value)
    return cls(**values)


def _check_names(place: str, values: Any, names: list[str]) -> None:
    if not isinstance(values, dict) or set(values) != set(names):
        raise ValueError(f"{place} is {values!r:.60}, not an object with {', '.join(names)}")


def _check(place: str, value: Any) -> None:
    name = place.rpartition(".")[2]
    if name == "sharpness":
        if type(value) not in (int, float) or not 0 <= value <= _MOST_SHARPNESS:
            raise ValueError(
                f"{place} is {value!r:.60}, not a number from 0 to {_MOST_SHARPNESS:g}"
            )
        return
    allowed = _ALLOWED.get(name, (True, False))
    # In Python, True is also the number 1.
    if not any(type(value) is type(each) and value == each for each in allowed):
        raise ValueError(f"{place} is {value!r:.60}, not {_told(allowed)}")


def _told(allowed: Iterable[Any]) -> str:
    if isinstance(allowed, range):
        return f"a whole number from {allowed[0]} to {allowed[-1]}"
    return f"one of {', '.join(str(each) for each in allowed)}"
