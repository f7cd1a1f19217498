"""Experts from Stable-Baselines3 archives, read without that library and without pickle.

An archive is a zip. Its `policy.pth` holds the weights, which `torch.load` reads with
`weights_only=True`: tensors, and nothing that could run. From the JSON `data` only plain text is
read. The statistics of `VecNormalize` are in a pickle beside the archive, and are not read: a
policy that was trained on normalised observations does poorly here.
"""

from __future__ import annotations

import io
import json
import re
import warnings
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from pickle import UnpicklingError  # Raised by torch; nothing is unpickled here.
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.language.reading import open_archive, unpack
from pipeline.config.errors import ConfigError

MAX_BYTES = 1 << 28
"""The largest size of a member of an archive; real policies have some hundred kilobytes."""

Array = NDArray[np.float64]
Function = Callable[[Array], Any]

_ACTIVATIONS: dict[str, Function] = {
    "Tanh": np.tanh,
    "ReLU": lambda values: np.maximum(values, 0),
    "LeakyReLU": lambda values: np.where(values > 0, values, 0.01 * values),
    "ELU": lambda values: np.where(values > 0, values, np.expm1(np.minimum(values, 0))),
}

_UNREADABLE = (OSError, ValueError, LookupError, AttributeError, TypeError, RuntimeError)
"""What libraries raise for files that are missing, damaged or of another kind."""

_LAYOUTS: list[tuple[str, str, Function]] = [
    (r"q_net\.q_net\.\d+", "ReLU", np.argmax),  # DQN
    (r"actor\.mu\.\d+", "ReLU", np.tanh),  # TD3, DDPG
    (r"actor\.(latent_pi\.\d+|mu)", "ReLU", np.tanh),  # SAC
    (r"mlp_extractor\.policy_net\.\d+|action_net", "Tanh", lambda mean: mean),  # PPO, A2C
]
"""What tells a policy of Stable-Baselines3 2.9 from its weights: a regular expression for the names
of its linear layers, the default activation between them, and what turns the last layer's values
into an action."""


def located(source: str) -> Path:
    """Return the path of an archive; download it if the source is an id on the Hub.

    Args:
        source: The path of a zip, or an id such as `sb3/td3-Hopper-v3`, whose file of the same
            name is downloaded (`td3-Hopper-v3.zip`).

    Raises:
        DatasetError: There is no such archive.
    """
    path = Path(source).expanduser()
    if path.is_file():
        return path
    if path.suffix == ".zip" or not re.fullmatch(r"[\w.-]+/[\w.-]+", source, re.ASCII):
        raise DatasetError(f"{source} is neither an archive (a .zip) nor an id on the Hub")
    from huggingface_hub import hf_hub_download

    from labyrinth_core.data.hub import UNAVAILABLE, limit_silence

    limit_silence()
    try:
        return Path(hf_hub_download(source, f"{source.rpartition('/')[2]}.zip"))
    except UNAVAILABLE as error:
        raise DatasetError(
            f"{source} is no file, and not to be had from the Hub: {one_line(error):.300}"
        ) from error


def read_archive(source: str, *, max_bytes: int = MAX_BYTES) -> Callable[[Array], int | Array]:
    """Return the deterministic policy of an archive: the mean, or the most likely action.

    Actions of SAC, TD3 and DDPG lie between -1 and 1, like those of the MuJoCo tasks here.

    Args:
        source: As for `located`.
        max_bytes: The largest size of a member of the archive that is read.

    Raises:
        ConfigError: The extra `train`, which brings torch, is missing.
        DatasetError: There is no such archive, or it holds no policy of a known kind.
    """
    weights, data = _unpacked(source, max_bytes)
    names = [name.removesuffix(".bias") for name in weights if name.endswith(".bias")]
    known = (
        (layers, activation, output)
        for pattern, activation, output in _LAYOUTS
        if (layers := [name for name in names if re.fullmatch(pattern, name)])
    )
    layers, default, output = next(known, ([], "", np.argmax))
    if not layers:
        raise DatasetError(f"{source}: no MlpPolicy of PPO, A2C, SAC, TD3, DDPG or DQN is in it")
    # PPO and A2C have a standard deviation for continuous actions only.
    if layers[-1] == "action_net" and "log_std" not in weights:
        output = np.argmax
    named = "".join(re.findall(r"\.(\w+)'>$", str(data.get("activation_fn", "")))) or default
    if named not in _ACTIVATIONS:
        raise DatasetError(f"{source}: activation {named}, not {', '.join(_ACTIVATIONS)}")

    def act(observation: Array) -> int | Array:
        values = observation
        for place, name in enumerate(layers):
            values = _ACTIVATIONS[named](values) if place else values
            values = values @ weights[f"{name}.weight"].T + weights[f"{name}.bias"]
        action: Any = output(values)
        return int(action) if np.ndim(action) == 0 else action

    return act


def _unpacked(source: str, max_bytes: int) -> tuple[dict[str, Array], Mapping[str, Any]]:
    """Return the weights by name, and the arguments of the policy."""
    try:
        import torch
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{source} needs torch: pip install 'labyrinth-datasets[train]'"
        ) from error

    path = located(source)
    try:
        with open_archive(path) as archive:
            stored = unpack(archive, "policy.pth", max_bytes)
            data = json.loads(unpack(archive, "data", max_bytes))
        if zipfile.is_zipfile(io.BytesIO(stored)):  # Torch has an older format, too.
            _check_sizes(open_archive(io.BytesIO(stored)), max_bytes)
        with warnings.catch_warnings():  # Torch warns of files it refuses, or reads anyway.
            warnings.simplefilter("ignore")
            tensors = torch.load(io.BytesIO(stored), map_location="cpu", weights_only=True)
        weights = {name: _as_array(name, tensor) for name, tensor in tensors.items()}
        return weights, dict(data.get("policy_kwargs", {}))
    except (*_UNREADABLE, UnpicklingError) as error:
        raise DatasetError(f"{source} is no archive to be read: {one_line(error):.300}") from error


def _check_sizes(archive: zipfile.ZipFile, max_bytes: int) -> None:
    """Raise ValueError if the files of an archive are larger than allowed once unpacked."""
    if sum(member.file_size for member in archive.infolist()) > max_bytes:
        raise ValueError(f"policy.pth takes more than {max_bytes:,} bytes")


def _as_array(name: str, tensor: Any) -> Array:
    """Return the numbers of a tensor, which may not be repeated by its strides."""
    if tensor.numel() * tensor.element_size() > tensor.untyped_storage().nbytes():
        raise ValueError(f"{name} has more numbers than the file holds")
    numbers: Array = tensor.double().numpy()
    return numbers
