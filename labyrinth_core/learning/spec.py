"""The specification of a policy's network in plain types: `config.json`, beside the weights.

The file is data: every value is checked against the allowed values, and nothing is executed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from math import inf
from typing import Any, ClassVar, TypedDict, TypeVar

from labyrinth_core import typed
from labyrinth_core.checks import Checks
from labyrinth_core.errors import printable_line
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE, PICTURE_SIZE
from labyrinth_core.world import SIDES, Task

KIND = "labyrinth-policy"
FORMAT = 1

PLANNER, MAPPER = "planner", "mapper"
"""The methods with a network of their own; in a `NetworkSpec` their name replaces the encoder."""


def checked(least: float | None = None, most: float = inf, one_of: Iterable[Any] = ()) -> Any:
    """Return a field that declares its allowed values as options of `pipeline.config` do.

    A method's settings can then inherit these fields, and are checked like its other settings.

    Args:
        least: The least value of a number; None for a boolean.
        most: The greatest value of a number.
        one_of: The values to choose from, instead of a range.
    """
    return field(metadata={"checks": Checks(least, most, [*one_of])})


@dataclass(frozen=True)
class NetworkSpec:
    """Everything that determines the shape of a network with an encoder."""

    ENCODERS: ClassVar[Mapping[str, str]] = {"cnn": "image", "resnet18": "image", "mlp": "vector"}
    """Encoder -> the observation that it encodes."""
    OWN: ClassVar[Sequence[str]] = (PLANNER, MAPPER)
    """The methods with a network of their own, which takes pictures."""

    encoder: str = checked(one_of=(*ENCODERS, *OWN))
    """An encoder, or the name of a method that has a network of its own."""
    height: int = checked(SIDES[0], SIDES[-1])
    """The height of the labyrinths in cells; the length of vectors depends on it."""
    width: int = checked(SIDES[0], SIDES[-1])
    task: str = checked(one_of=map(str, Task))

    @property
    def observation(self) -> str:
        """What the network looks at: image or vector."""
        return self.ENCODERS.get(self.encoder, "image")

    def require_same_vectors(self, height: int, width: int, task: Task) -> None:
        """Raise PolicyError if the network takes vectors, and those of such labyrinths differ."""
        from labyrinth_core.evaluation import PolicyError

        own = self.height, self.width, Task(self.task).rules.positions
        if self.observation == "vector" and own != (height, width, task.rules.positions):
            raise PolicyError(
                f"the policy needs vectors of {self.height}x{self.width}, {self.task}: those of "
                f"{height}x{width}, {task}, have another layout"
            )


MOST_ITERATIONS = 2000
"""The largest number of iterations of 32 channels that a picture may take without `path_prior`.

A picture of a 5x5 labyrinth then takes 0.16 s on one core, as a ResNet-18 does that averages over
the symmetries. More channels count by their square; without `grid_prior` there are ten times as
many positions.
"""


@dataclass(frozen=True)
class PlannerSpec:
    """The settings of `method=planner` that determine its network."""

    path_prior: bool = checked()
    """Whether planning adds up the costs of steps and takes the cheapest route."""
    grid_prior: bool = checked()
    """Whether the network knows how many pixels a cell has."""
    colour_prior: bool = checked()
    """Whether the agent is found by its colour."""
    channels: int = checked(1, 1024)
    iterations: int = checked(1, 1000)
    """The number of iterations of planning, in cells. With `path_prior` it applies in training
    only: a policy that acts plans until nothing changes."""
    sharpness: float = checked(0, 1000)
    """The power to which costs are raised when acting, with `grid_prior` only: the longer the
    routes of a labyrinth, the more a wall has to cost."""

    def require_bounded(self, average: bool) -> None:
        """Raise ValueError if acting takes longer than `MOST_ITERATIONS` allows.

        With `path_prior`, planning ends by itself.
        """
        each = (
            (8 if average else 1) * (1 if self.grid_prior else 10) * max(1, self.channels / 32) ** 2
        )
        most = int(MOST_ITERATIONS / each)
        if not self.path_prior and self.iterations > most:
            without = "path_prior" if self.grid_prior else "path_prior and grid_prior"
            raise ValueError(
                f"iterations is {self.iterations}: without {without}, channels={self.channels} and "
                f"average={str(average).lower()} allow at most {most}, as each takes time in every "
                "picture; give fewer iterations or channels"
            )


@dataclass(frozen=True)
class MapperSpec:
    """The settings of `method=mapper` that determine its network."""

    channels: int = checked(1, 1024)
    """The width of the hidden layers."""
    looks: int = checked(1, 64)
    """The number of features per colour that decide whether it blocks."""


_OWN = {PLANNER: PlannerSpec, MAPPER: MapperSpec}
"""Method with a network of its own -> the class of the network's settings."""


@dataclass(frozen=True)
class PolicySpec:
    """The specification of a policy's network, and of the observations it needs."""

    FILE: ClassVar[str] = "config.json"
    WEIGHTS: ClassVar[str] = "model.safetensors"
    """The two files of a policy, trained or published: this specification, and the weights."""

    network: NetworkSpec
    average: bool
    """Whether its outputs are averaged over the symmetries of the picture."""
    own: PlannerSpec | MapperSpec | None = None
    """The settings of a network without an encoder."""
    resize: str = "area"
    """How its pictures are made smaller; one of `RESIZES`."""

    @property
    def observation(self) -> str:
        """What the policy looks at: image or vector."""
        return self.network.observation

    @property
    def remembers(self) -> bool:
        """Whether the policy plans once in an episode, and remembers the plan."""
        return isinstance(self.own, MapperSpec)

    @property
    def knows_how_to_plan(self) -> bool:
        """Whether planning, or a part of it, is built into the network."""
        return isinstance(self.own, PlannerSpec)

    @property
    def image_size(self) -> int | None:
        """Pixels on each side of its training pictures; None for vectors."""
        if self.network.encoder == MAPPER:
            return PICTURE_SIZE
        return DEFAULT_IMAGE_SIZE if self.observation == "image" else None

    def image_size_in(self, height: int, width: int) -> int | None:
        """Return the pixels on each side of its pictures for labyrinths of another size.

        For a planner, the number of pixels per cell stays the same.
        """
        if self.network.encoder == PLANNER:
            trained_on = max(self.network.height, self.network.width)
            return round(DEFAULT_IMAGE_SIZE * max(height, width) / trained_on)
        return self.image_size

    def require_fit(self, height: int, width: int, task: Task) -> None:
        """Raise PolicyError if the policy cannot be shown labyrinths of this size and task."""
        from labyrinth_core.evaluation import PolicyError

        self.network.require_same_vectors(height, width, task)
        if isinstance(self.own, PlannerSpec) and self.own.grid_prior and height != width:
            raise PolicyError(
                f"the policy is a planner with grid_prior=true, which needs as many rows as "
                f"columns: {height}x{width} cannot be shown to it"
            )

    def to_json(self) -> dict[str, Any]:
        """Return the content of `config.json`."""
        own = {} if self.own is None else {self.network.encoder: asdict(self.own)}
        resize = {} if self.resize == "area" else {"resize": self.resize}
        return {
            "kind": KIND,
            "format": FORMAT,
            "observation": self.observation,
            "image_size": self.image_size,
            "network": asdict(self.network),
            "average": self.average,
            **own,
            **resize,
        }

    @classmethod
    def of_method(cls, network: NetworkSpec, settings: Any, resize: str) -> PolicySpec:
        """Return the specification of the policy that a method trains.

        Args:
            network: The network.
            settings: The settings of the method.
            resize: How its pictures are made smaller.
        """
        own = None
        if (spec := _OWN.get(network.encoder)) is not None:
            own = spec(**{each.name: getattr(settings, each.name) for each in fields(spec)})
        return cls(network, getattr(settings, "average", False), own, resize)

    @classmethod
    def from_json(cls, content: Any) -> PolicySpec:
        """Return the specification in the content of a `config.json`.

        Raises:
            ValueError: The content has another form, or a value that is not allowed.
        """
        from labyrinth_core.pictures import RESIZES

        content = typed.read_as(_Config, content)
        network = _read(NetworkSpec, content["network"], "network")
        name, average = network.encoder, content["average"]
        own = _read(_OWN[name], content.get(name), name) if name in _OWN else None
        if average and name == MAPPER:
            raise ValueError("average is True, but a mapper does not average over symmetries")
        if isinstance(own, PlannerSpec):
            own.require_bounded(average)
        resize = content.get("resize", "area")
        _require_one_of("resize", resize, RESIZES)
        spec = cls(network, average, own, resize)
        expected = spec.to_json()
        for name in content:
            if name not in expected:
                raise ValueError(f"it has {printable_line(name):.60}, which is unknown")
        for name, value in expected.items():
            if content.get(name) != value:
                raise ValueError(f"{name} is {content.get(name)!r:.60}, not {value!r}")
        return spec


class _Config(TypedDict):
    """What every `config.json` has, besides what follows from it."""

    network: Mapping[str, Any]
    average: bool


Spec = TypeVar("Spec")


def _read(cls: type[Spec], values: Any, name: str) -> Spec:
    """Return the values of a class whose fields `checked` declares."""
    read: Spec = typed.read_as(cls, values, name)
    for each in fields(cls):  # type: ignore[arg-type]
        checks: Checks = each.metadata["checks"]
        value, least, most = getattr(read, each.name), checks.at_least, checks.at_most
        if checks.one_of:
            _require_one_of(f"{name}.{each.name}", value, checks.one_of)
        elif least is not None and not least <= value <= most:
            told = f"{name}.{each.name} is {value!r:.60}"
            raise ValueError(f"{told}, not a number from {least:g} to {most:g}")
    return read


def _require_one_of(name: str, value: Any, allowed: Iterable[Any]) -> None:
    if value not in (known := [*allowed]):
        raise ValueError(f"{name} is {value!r:.60}, not one of {', '.join(map(str, known))}")
