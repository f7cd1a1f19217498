"""Policies by name, `policy=...`: `module:name` in Python, or one that was published.

Torch is not imported here, as a policy of one's own may not need it.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from labyrinth_core import evaluate
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.evaluation.answers import Player, PolicyError, asked, fitted
from labyrinth_core.evaluation.description import DETAILS, Description
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays, load_arrays
from labyrinth_core.evaluation.results import RESULTS, Results
from labyrinth_core.policies.load import load_policy
from labyrinth_core.policies.spec import RECORD
from pipeline.config.errors import ConfigError, listed
from pipeline.config.run import Run
from pipeline.config.training import EvaluationOptions
from pipeline.machinery.artifact import Key, Sums
from pipeline.machinery.dataset import manifest_of

INSTEAD = "choose another evaluation.name"


class Judged(NamedTuple):
    """A policy, and what it achieves."""

    about: Description
    player: Player
    """The policy, as it is asked."""
    load: Callable[..., LabyrinthArrays]
    """Returns the labyrinths of a split, as the policy observes them."""
    results: Results
    path: Path
    """Where the results are kept."""
    key: Key
    """What the folder of the results is of: a run, or a policy."""


def judge_named(run: Run) -> Judged:
    """Return what the policy achieves that `policy` names.

    Raises:
        ConfigError: There is no such policy, or an option is impossible.
        DatasetError: The policy or the dataset cannot be read, or a split is missing.
        PolicyError: The policy raises an error, answers with anything but actions, or cannot be
            shown these labyrinths.
    """
    options, asked = run.options, run.options.evaluation
    name = asked.name.strip() or Path(options.policy).name
    runs = Path(options.run_dir).expanduser() / run.dataset.name
    path = runs / _as_file_name(name) / RESULTS
    if not asked.name and path.with_name(RECORD).exists():  # A run has results of its own there.
        name = f"{name} as policy"
        path = runs / _as_file_name(name) / RESULTS
    if path.with_name(RECORD).exists():
        raise DatasetError(f"{path.parent} holds a trained run: {INSTEAD}")
    key = {"policy": name}
    require_free(path, key, run)
    config = manifest_of(run).config  # Says how the dataset is made, if there is none.
    policy = named_policy(options.policy)
    # The option's default says nothing: a policy may look at something else.
    observation = None if options.observation == "image" else options.observation
    try:
        about = _description(name, asked)  # First, as the evaluation may take long.
        policy, spec = fitted(
            policy,
            config.height,
            config.width,
            config.task,
            observation=observation,
            image_size=asked.image_size,
        )
        shown: dict[str, Any] = {
            "observation": spec.observation,
            "image_size": spec.image_size,
            "revision": options.revision,
        }
        results = evaluate(
            policy,
            run.source,
            run.dataset.name,
            episodes=asked.episodes,
            seed=options.seed,
            splits=asked.splits or None,
            **shown,
        )
    except PolicyError:
        raise
    except ValueError as error:
        raise ConfigError(str(error)) from error
    load = partial(load_arrays, run.source, run.dataset.name, resize=spec.resize, **shown)
    return Judged(about, Player.of(policy, options.seed), load, results, path, key)


def require_free(path: Path, key: Key, run: Run) -> None:
    """Raise DatasetError if results could not be kept at a path."""
    Sums.read(path.parent).require_free({path.name: b""}, key, run.options.overwrite, INSTEAD)


def _description(name: str, asked: EvaluationOptions) -> Description:
    numbers = (asked.train_labyrinths, asked.train_steps, asked.parameters)
    details = dict(zip(DETAILS, numbers, strict=True))
    stated = {what: number for what, number in details.items() if number is not None}
    return Description(name, asked.author, asked.url, asked.date, asked.budget, stated)


def _as_file_name(name: str) -> str:
    """Return a name without what file systems and shells do not like."""
    return re.sub(r"[^\w.-]+", "-", name).strip("-.") or "policy"


def named_policy(name: str) -> Any:
    """Return the policy that a name stands for.

    Args:
        name: `module:name`, a policy in a module of the working directory or an installed one, or
            a class or a function without arguments that makes one; the folder of a run or of a
            published policy; or an id on the Hub such as `user/planner-5x5` or
            `user/planner-5x5@1.0.0`.

    Raises:
        ConfigError: There is no such module or name, or a folder is given with a revision.
        DatasetError: The policy of a run, or a published one, cannot be read.
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
    module, _, attribute = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:  # As for `python -m`; the installed command has its own folder there.
        sys.path.insert(0, here)
    found: Any = _imported(name, module)
    for part in attribute.split("."):
        if not hasattr(found, part):
            known = [each for each in vars(found) if not each.startswith("_")]
            raise ConfigError(f"policy={name}: there is no {part}, only {listed(known)}")
        found = getattr(found, part)
    return asked(found) if _makes_one(found) else found


def _imported(name: str, module: str) -> Any:
    try:
        return asked(import_module, module)
    except PolicyError as error:
        cause = error.__cause__
        if isinstance(cause, ModuleNotFoundError) and f"{module}.".startswith(f"{cause.name}."):
            here = Path.cwd()
            reason = f"there is no module {cause.name}, neither in {here} nor installed"
            raise ConfigError(f"policy={name}: {reason}") from error
        raise


def _makes_one(found: Any) -> bool:
    """Return whether something is not a policy itself, but called without arguments makes one."""
    if inspect.isclass(found):
        return True
    if not inspect.isroutine(found):
        return False
    parameters = inspect.signature(found).parameters.values()
    variable = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return not any(each.default is each.empty and each.kind not in variable for each in parameters)
