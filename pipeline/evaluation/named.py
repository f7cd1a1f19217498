"""Evaluate the policy named by `policy=...`: a Python object `module:name`, or a published policy.

This module does not import torch, which a user's own policy may not need.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from labyrinth_core import evaluate
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.evaluation.answers import Player, PolicyError, asked, fitted
from labyrinth_core.evaluation.description import DETAILS, Description
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays, arrays_in
from labyrinth_core.evaluation.results import RESULTS, Results
from labyrinth_core.policies.load import load_policy
from labyrinth_core.policies.spec import RECORD
from pipeline.config.errors import ConfigError
from pipeline.config.stage import Job
from pipeline.config.training import named
from pipeline.evaluation.options import EvaluateOptions, EvaluationOptions
from pipeline.machinery.artifact import Key, Sums
from pipeline.machinery.dataset import dataset_of

INSTEAD, OTHER_RUNS = "choose another evaluation.name", "choose another run_dir"


class Judged(NamedTuple):
    """A policy and its results."""

    about: Description
    player: Player
    """The policy, wrapped for evaluation."""
    load: Callable[..., LabyrinthArrays]
    """Returns the labyrinths of a split with the policy's observation."""
    results: Results
    path: Path
    """The file for the results."""
    key: Key
    """Identifies the run or the policy that the folder of the results belongs to."""


def judge_named(job: Job[EvaluateOptions]) -> Judged:
    """Evaluate the policy that the option `policy` names, and return its results.

    Raises:
        ConfigError: The policy does not exist, or an option is not allowed.
        DatasetError: The policy or the dataset cannot be read, or a split is missing.
        PolicyError: The policy fails, returns no actions, or does not support these labyrinths.
    """
    options, asked = job.options, job.options.evaluation
    name = asked.name.strip() or Path(options.policy).name
    runs = Path(options.run_dir).expanduser() / job.dataset.name
    path = runs / _as_file_name(name) / RESULTS
    if not asked.name and path.with_name(RECORD).exists():  # A run keeps its own results there.
        name = f"{name} as policy"
        path = runs / _as_file_name(name) / RESULTS
    if path.with_name(RECORD).exists():
        raise DatasetError(f"{path.parent} holds a trained run: {INSTEAD}")
    data = dataset_of(job)  # Its error says how to make a dataset that is missing.
    config = data.manifest.config
    key = {"policy": options.policy.rstrip("/"), "name": name, "fingerprint": data.fingerprint}
    require_free(path, key, job)
    policy = named_policy(options.policy)
    # "image" is the option's default, so it does not say what the policy observes.
    observation = None if options.observation == "image" else options.observation
    try:
        about = _description(name, asked)  # Checked first, as the evaluation may take long.
        policy, spec = fitted(
            policy,
            config.height,
            config.width,
            config.task,
            observation=observation,
            image_size=asked.image_size,
        )
    except PolicyError:
        raise
    except ValueError as error:
        raise ConfigError(str(error)) from error
    results = evaluate(
        policy,
        data,
        observation=spec.observation,
        image_size=spec.image_size,
        episodes=asked.episodes,
        seed=job.dataset.seed,
        splits=asked.splits or None,
    )

    def load(split: str) -> LabyrinthArrays:
        return arrays_in(data[split], spec)

    return Judged(about, Player.of(policy, job.dataset.seed), load, results, path, key)


def require_free(path: Path, key: Key, job: Job[EvaluateOptions]) -> None:
    """Raise a DatasetError if results may not be written to `path`."""
    overwrite, instead = job.options.overwrite, INSTEAD if job.options.policy else OTHER_RUNS
    own = Sums.read(path.parent, overwrite=overwrite)
    own.require_free({path.name: b""}, key, overwrite, instead)


def _description(name: str, asked: EvaluationOptions) -> Description:
    numbers = (asked.train_labyrinths, asked.train_steps, asked.parameters)
    details = dict(zip(DETAILS, numbers, strict=True))
    stated = {what: number for what, number in details.items() if number is not None}
    return Description(name, asked.author, asked.url, asked.date, asked.budget, stated)


def _as_file_name(name: str) -> str:
    """Return a name that is safe in file systems and shells."""
    return re.sub(r"[^\w.-]+", "-", name).strip("-.") or "policy"


def named_policy(name: str) -> Any:
    """Load a policy by its name.

    Args:
        name: `module:name` in an installed module or the working directory, which is a policy, or a
            class or function without arguments that makes one; the folder of a run or of a
            published policy; an id on the Hub, as `user/planner-5x5` or `user/planner-5x5@1.0.0`.

    Raises:
        ConfigError: The module or the name does not exist, or a folder is given with a revision.
        DatasetError: The policy of a job, or a published one, cannot be read.
        PolicyError: The module, the class or the function raises an error.
    """
    if ":" not in name:
        source, _, revision = name.partition("@")
        is_folder = Path(source).expanduser().is_dir()
        if is_folder and revision:
            raise ConfigError(f"policy={name}: {source} is a folder, which has no revisions")
        if "/" not in source and not is_folder:
            allowed = "neither a folder nor an id such as user/planner-5x5"
            raise DatasetError(f"{source} is {allowed}: a policy in Python is module:name")
        return load_policy(source, revision=revision or None)
    found = named(f"policy={name}", name, partial(asked, import_module))
    return asked(found) if _makes_one(found) else found


def _makes_one(found: Any) -> bool:
    """Return whether an object is a class or a function without arguments that makes a policy."""
    if inspect.isclass(found):
        return True
    if not inspect.isroutine(found):
        return False
    parameters = inspect.signature(found).parameters.values()
    variable = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return not any(each.default is each.empty and each.kind not in variable for each in parameters)
