"""Policies out of Stable-Baselines3 archives, read without that library and without pickle.

An archive is a zip. `policy.pth` in it holds the weights, which `torch.load` reads with
`weights_only=True`: tensors, and nothing that could run. Of the JSON `data` only plain text is
read. The statistics of `VecNormalize` are not in an archive but in a pickle beside it, and are
not read: a policy that was trained on normalised observations does poorly here.
"""

from __future__ import annotations

import io
import json
import re
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from pickle import UnpicklingError  # Of a file that torch refuses; nothing is unpickled here.
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError, one_line
from pipeline.config.errors import ConfigError

MAX_BYTES = 1 << 28
"""Of a member of an archive, unpacked; the policies meant here have some hundred kilobytes."""

Array = NDArray[np.float64]
Function = Callable[[Array], Any]

_ACTIVATIONS: dict[str, Function] = {
    "Tanh": np.tanh,
    "ReLU": lambda values: np.maximum(values, 0),
    "LeakyReLU": lambda values: np.where(values > 0, values, 0.01 * values),
    "ELU": lambda values: np.where(values > 0, values, np.expm1(np.minimum(values, 0))),
}


_UNREADABLE = (OSError, ValueError, LookupError, AttributeError, TypeError, RuntimeError)
"""What libraries raise for files that are missing, damaged or something else."""


class _Layout(NamedTuple):
    """How the policies of some algorithms lie among their weights (Stable-Baselines3 2.9)."""

    layers: str
    """Regular expression for the names of the linear layers, in order."""
    activation: str
    """Between them, unless the archive says otherwise."""
    output: Function
    """What becomes of the last layer's values."""


_LAYOUTS = [
    _Layout(r"q_net\.q_net\.\d+", "ReLU", np.argmax),  # DQN
    _Layout(r"actor\.mu\.\d+", "ReLU", np.tanh),  # TD3, DDPG
    _Layout(r"actor\.(latent_pi\.\d+|mu)", "ReLU", np.tanh),  # SAC
    _Layout(r"mlp_extractor\.policy_net\.\d+|action_net", "Tanh", lambda mean: mean),  # PPO, A2C
]


def located(source: str) -> Path:
    """Return an archive on this machine, downloaded if it is an id on the Hub.

    Args:
        source: The path of a zip, or an id such as `sb3/td3-Hopper-v3`, of which the file of the
            same name is taken (`td3-Hopper-v3.zip`).

    Raises:
        DatasetError: There is none.
    """
    path = Path(source).expanduser()
    if path.is_file():
        return path
    if path.suffix == ".zip" or not re.fullmatch(r"[\w.-]+/[\w.-]+", source, re.ASCII):
        raise DatasetError(f"{source} is neither an archive (a .zip) nor an id on the Hub")
    from huggingface_hub import hf_hub_download
    from huggingface_hub.errors import HfHubHTTPError, HFValidationError

    try:
        return Path(hf_hub_download(source, f"{source.rpartition('/')[2]}.zip"))
    except (OSError, HfHubHTTPError, HFValidationError) as error:
        raise DatasetError(
            f"{source} is no file, and not to be had from the Hub: {one_line(error):.300}"
        ) from error


def read_archive(source: str) -> Callable[[Array], int | Array]:
    """Return the deterministic policy of an archive: the mean, or the most likely action.

    Actions of SAC, TD3 and DDPG are between -1 and 1, as those of the MuJoCo tasks here.

    Args:
        source: As for `located`.

    Raises:
        ConfigError: The extra `train`, which brings torch, is missing.
        DatasetError: There is no such archive, or it holds no policy of a kind known here.
    """
    weights, activation = _unpacked(source)
    names = [name.removesuffix(".bias") for name in weights if name.endswith(".bias")]
    for layout in _LAYOUTS:
        layers = sorted((name for name in names if re.fullmatch(layout.layers, name)), key=_place)
        if layers:
            break
    else:
        raise DatasetError(f"{source}: no MlpPolicy of PPO, A2C, SAC, TD3, DDPG or DQN is in it")
    # Only continuous actions of PPO and A2C have a deviation.
    discrete = layers[-1] == "action_net" and "log_std" not in weights
    return _policy(
        [(weights[f"{name}.weight"], weights[f"{name}.bias"]) for name in layers],
        _ACTIVATIONS[activation or layout.activation],
        np.argmax if discrete else layout.output,
    )


def _place(name: str) -> tuple[bool, int]:
    """Return the order of a layer: by number, and what has none last."""
    number = name.rpartition(".")[2]
    return (not number.isdigit(), int(number) if number.isdigit() else 0)


def _policy(
    layers: list[tuple[Array, Array]], activation: Function, output: Function
) -> Callable[[Array], int | Array]:
    def act(observation: Array) -> int | Array:
        values = observation
        for place, (weight, bias) in enumerate(layers):
            values = weight @ (activation(values) if place else values) + bias
        action = output(values)
        return int(action) if np.ndim(action) == 0 else action

    return act


def _unpacked(source: str) -> tuple[dict[str, Array], str]:
    """Return the weights by name, and the activation, empty where the archive is silent."""
    try:
        import torch
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"analysis.experts: {source} needs torch: pip install 'labyrinth-datasets[train]'"
        ) from error

    path = located(source)
    try:
        with zipfile.ZipFile(path) as archive:
            stored = io.BytesIO(_member(archive, "policy.pth"))
            with warnings.catch_warnings():  # Of what is refused, or read all the same.
                warnings.simplefilter("ignore")
                tensors = torch.load(stored, map_location="cpu", weights_only=True)
            data = json.loads(_member(archive, "data"))
        weights = {name: tensor.double().numpy() for name, tensor in tensors.items()}
        described = data.get("policy_kwargs", {}).get("activation_fn", "")
        activation = "".join(re.findall(r"\.(\w+)'>$", described))
    except (*_UNREADABLE, UnpicklingError, zipfile.BadZipFile) as error:
        raise DatasetError(f"{source} is no archive to be read: {one_line(error):.300}") from error
    if activation and activation not in _ACTIVATIONS:
        raise DatasetError(f"{source}: activation {activation}, not {', '.join(_ACTIVATIONS)}")
    return weights, activation


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    if archive.getinfo(name).file_size > MAX_BYTES:
        raise ValueError(f"{name} takes more than {MAX_BYTES:,} bytes")
    return archive.read(name)
