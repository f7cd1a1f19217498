"""What a policy's network is made from, in plain types: `config.json`, beside its weights.

The file is data: each value in it is checked against what is allowed, and nothing in it is run.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import Field, asdict, dataclass, field, fields
from math import inf
from typing import Any, TypeVar

from labyrinth_core.data.observations import RESIZES
from labyrinth_core.evaluation.answers import PolicyError
from labyrinth_core.evaluation.schema import Exactly, Number, OneOf, check_shape
from labyrinth_core.pictures.png import DEFAULT_IMAGE_SIZE, PICTURE_SIZE
from labyrinth_core.pictures.vector import tile_count
from labyrinth_core.world.labyrinth import MAX_SIDE, MIN_SIDE, Task

CONFIG = "config.json"
WEIGHTS = "model.safetensors"
"""The names of the two files of a policy that is published."""

RECORD, POLICY = "run.json", "policy.safetensors"
"""The names of the two files of a run that its policy is read from: `PolicySpec.of_run`."""

GRAPH = "model.onnx"
"""The only file of a policy that is an ONNX graph; a season's judge reads it, not `load_policy`."""

KIND = "labyrinth-policy"
FORMAT = 1

ENCODERS = {"cnn": "image", "resnet18": "image", "mlp": "vector"}
"""Encoder -> what it looks at."""

RESIZE_OF_PROTOCOL = {"default": "area", "paper": "original", "authors": "original"}
"""Protocol of training -> how pictures become small, one of `RESIZES`."""

PLANNER, MAPPER = "planner", "mapper"
"""The methods with a network of their own; in a `NetworkSpec` they stand for the encoder."""


def checked(least: float | None = None, most: float = inf, one_of: Iterable[Any] = ()) -> Any:
    """Return a field with its allowed values, in the form of an option of `pipeline.config`.

    So a method's settings can inherit fields from here, and are checked like its other settings.

    Args:
        least: The least value of a number; None for a boolean.
        most: The greatest value of a number.
        one_of: The values to choose from, instead of a range.
    """
    return field(metadata={"checks": (least, most, list(one_of), None)})


@dataclass(frozen=True)
class NetworkSpec:
    """Everything that the shape of a network with an encoder depends on."""

    encoder: str = checked(one_of=(*ENCODERS, PLANNER, MAPPER))
    """An encoder, or the name of a method that has a network of its own."""
    height: int = checked(MIN_SIDE, MAX_SIDE)
    """The height of the labyrinths in cells, on which the length of vectors depends."""
    width: int = checked(MIN_SIDE, MAX_SIDE)
    task: str = checked(one_of=map(str, Task))


@dataclass(frozen=True)
class PlannerSpec:
    """The settings of `method=planner` on which its network depends."""

    path_prior: bool = checked()
    """Whether costs of steps add up, and the cheapest way is taken."""
    grid_prior: bool = checked()
    """Whether the number of pixels of a cell is known."""
    colour_prior: bool = checked()
    """Whether the agent is found by its colour."""
    channels: int = checked(1, 1024)
    iterations: int = checked(1, 1000)
    """The number of iterations of planning, in cells. With `path_prior` it holds in training only:
    a policy that acts plans until nothing changes."""
    sharpness: float = checked(0, 1000)
    """The power to which costs are raised when acting, with `grid_prior` only: the longer the ways
    of a labyrinth, the more a wall has to cost."""


@dataclass(frozen=True)
class MapperSpec:
    """The settings of `method=mapper` on which its network depends."""

    channels: int = checked(1, 1024)
    """The width of the hidden layers."""
    looks: int = checked(1, 64)
    """The number of features of a colour that may block."""


OWN = {PLANNER: PlannerSpec, MAPPER: MapperSpec}
"""Method with a network of its own -> the settings on which that depends."""


@dataclass(frozen=True)
class PolicySpec:
    """What a policy's network is made from, and what the policy has to be shown."""

    network: NetworkSpec
    average: bool
    """Whether it is averaged over the symmetries of the picture."""
    own: PlannerSpec | MapperSpec | None = None
    """The settings of a network without an encoder."""
    resize: str = "area"
    """How its pictures become small; one of `RESIZES`."""

    @property
    def observation(self) -> str:
        """What the policy looks at: image or vector."""
        return ENCODERS.get(self.network.encoder, "image")

    @property
    def image_size(self) -> int | None:
        """Pixels on each side of the pictures that it was trained on; None for vectors."""
        if self.network.encoder == MAPPER:
            return PICTURE_SIZE
        return DEFAULT_IMAGE_SIZE if self.observation == "image" else None

    def image_size_in(self, height: int, width: int) -> int | None:
        """Return the pixels on each side of its pictures of labyrinths of another size.

        A planner's cells keep their number of pixels.
        """
        if self.network.encoder == PLANNER:
            trained_on = max(self.network.height, self.network.width)
            return round(DEFAULT_IMAGE_SIZE * max(height, width) / trained_on)
        return self.image_size

    def require_fit(self, height: int, width: int, task: Task) -> None:
        """Raise a PolicyError if labyrinths of a size and task cannot be shown to the policy."""
        network, shape = self.network, f"{height}x{width}"
        if self.observation == "vector":
            own = network.height, network.width, tile_count(Task(network.task))
            if own != (height, width, tile_count(task)):
                raise PolicyError(
                    f"the policy looks at vectors of {network.height}x{network.width}, "
                    f"{network.task}: those of {shape}, {task}, have another meaning"
                )
        if isinstance(self.own, PlannerSpec) and self.own.grid_prior and height != width:
            raise PolicyError(
                f"the policy is a planner with grid_prior=true, which needs as many rows as "
                f"columns: {shape} cannot be shown to it"
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
    def of_run(cls, network: Any, run: Any) -> PolicySpec:
        """Return what the policy of a run is made from; `from_json` checks its content.

        Args:
            network: The fields of its `NetworkSpec`.
            run: What determines the run, among it the `settings` of its method.

        Raises:
            ValueError: The protocol of the run does not exist, or the network has other fields.
        """
        shape, settings = _read(NetworkSpec, network, "network"), run["settings"]
        check_shape(run["protocol"], OneOf(tuple(RESIZE_OF_PROTOCOL)), "protocol")
        resize = RESIZE_OF_PROTOCOL[run["protocol"]]
        of_method = OWN.get(shape.encoder)
        own = None
        if of_method is not None:
            own = of_method(**{each.name: settings.get(each.name) for each in fields(of_method)})
        return cls(shape, settings.get("average", False), own, resize)

    @classmethod
    def from_json(cls, content: Any) -> PolicySpec:
        """Return what the content of a `config.json` describes.

        Raises:
            ValueError: It has another form, or a value that is not allowed.
        """
        check_shape(content, {"network": None, "average": None})
        network = _read(NetworkSpec, content["network"], "network")
        name, average = network.encoder, content["average"]
        check_shape(average, _BOOLEAN, "average")
        own = _read(OWN[name], content.get(name), name) if name in OWN else None
        if average and name == MAPPER:
            raise ValueError("average is True, but a mapper looks at a picture in one way")
        resize = content.get("resize", "area")
        check_shape(resize, OneOf(tuple(RESIZES)), "resize")
        spec = cls(network, average, own, resize)
        expected = spec.to_json()
        check_shape(content, Exactly(dict.fromkeys(expected)))
        for name, value in expected.items():
            if content[name] != value:
                raise ValueError(f"{name} is {content[name]!r:.60}, not {value!r}")
        return spec


Spec = TypeVar("Spec")


def _read(cls: type[Spec], values: Any, place: str) -> Spec:
    declared = fields(cls)  # type: ignore[arg-type]
    check_shape(values, Exactly({each.name: _shape_of(each) for each in declared}), place)
    return cls(**values)


_BOOLEAN = OneOf((True, False))


def _shape_of(declared: Field[Any]) -> Any:
    """Return the shape of the values of a field that `checked` declared."""
    least, most, one_of, _ = declared.metadata["checks"]
    if declared.type == "bool":
        return _BOOLEAN
    return OneOf(tuple(one_of)) if one_of else Number(least, most, whole=declared.type == "int")
