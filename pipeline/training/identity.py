"""What determines a run: its options compared with a record, its network, and its device."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labyrinth_core.errors import DatasetError
from labyrinth_core.learning import NetworkSpec
from labyrinth_core.storage import File
from pipeline.config import ConfigError, Job, TrainingOptions
from pipeline.machinery import Sums

if TYPE_CHECKING:
    import torch


def identify(
    job: Job[TrainingOptions], settings: Mapping[str, Any], fingerprint: str
) -> dict[str, Any]:
    """Return everything that determines the weights of a job, in plain types.

    Of a user's method it has the hash of its module, but not of what that imports.
    """
    options = job.options
    module, of_user, _ = options.method_name.partition(":")
    own = getattr(import_module(module), "__file__", None) if of_user else None
    code = {} if own is None else {"code": f"{Path(own).name} {File(Path(own)).sha256():.12}"}
    return {
        "method": options.method_name,
        "encoder": options.network,
        "observation": options.observation,
        "protocol": options.protocol,
        "train_labyrinths": options.train_labyrinths,
        "seed": job.dataset.seed,
        "settings": dict(settings),
        "config": job.dataset.name,
        "dataset": job.source,
        "revision": options.revision,
        "fingerprint": fingerprint,
        **code,
    }


def spec_of(job: Job[TrainingOptions]) -> NetworkSpec:
    """Return the specification of the network of a run's policy."""
    dataset = job.dataset
    return NetworkSpec(job.options.network, dataset.height, dataset.width, str(dataset.task))


def require_same(
    thing: str, actual: Mapping[str, Any], required: Mapping[str, Any], advice: str = ""
) -> None:
    """Raise a DatasetError that lists how `actual` differs from `required`, if it does."""
    if differing := Sums.differences(options_of(actual), options_of(required)):
        raise DatasetError(f"{thing} with {differing}{advice}")


def without_place(identity: Mapping[str, Any]) -> dict[str, Any]:
    """Return what determines a run's weights, which does not depend on where its dataset lies.

    The fingerprint of the dataset says which it is.
    """
    return {name: value for name, value in identity.items() if name not in ("dataset", "revision")}


def options_of(description: Mapping[str, Any]) -> dict[str, Any]:
    """Return a run's description with each setting under the name of its option, `method.NAME`."""
    options = {name: value for name, value in description.items() if name != "settings"}
    settings = description.get("settings", {})
    return options | {f"method.{name}": value for name, value in settings.items()}


def choose_device(options: TrainingOptions) -> torch.device:
    """Set the number of threads, and return the device to compute on.

    Raises:
        ConfigError: The device does not exist.
    """
    import torch

    if options.threads is not None:
        torch.set_num_threads(options.threads)
    available = torch.accelerator.is_available()
    accelerator = torch.accelerator.current_accelerator() if available else None
    if options.device == "cuda" and (accelerator is None or accelerator.type != "cuda"):
        raise ConfigError("device=cuda: no such device is available; choose cpu or auto")
    return torch.device("cpu") if accelerator is None or options.device == "cpu" else accelerator
