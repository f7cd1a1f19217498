"""The options that name a training run: what is trained, on what, and where.

This module does not import torch, so that `labyrinth-datasets --help` stays quick.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.util import find_spec
from math import inf
from pathlib import Path
from typing import Any

from labyrinth_core.evaluation.description import FRESH, RunName
from labyrinth_core.policies.spec import ENCODERS, OWN, RESIZE_OF_PROTOCOL
from pipeline.config.errors import ConfigError, check, listed
from pipeline.config.option import check_options, option
from pipeline.config.options import RunFolderOption, SourceOptions
from pipeline.config.stage import Job

METHODS = ("bc", "dagger", "gail", "bco", "sqil", "iupe", "planner", "mapper")
"""The modules of the methods in the package `OURS`, and their files in `conf/method`."""

OURS = "pipeline.training.methods"

SUBMISSIONS = "submissions"
"""The folder in `results_dir` for the results of submitted policies."""


@dataclass(frozen=True)
class Protocol:
    """How pictures are shrunk, and when training ends."""

    resize: str
    """One of `data.observations.RESIZES`: `area` keeps every wall, `original` does not."""
    evaluate_every: int | None = None
    """The number of epochs between evaluations; None for the method's own."""
    patience: float = inf
    """The number of evaluations without a better validation success rate that end training."""


PROTOCOLS = {
    "default": Protocol(resize=RESIZE_OF_PROTOCOL["default"]),
    "paper": Protocol(resize=RESIZE_OF_PROTOCOL["paper"], evaluate_every=10, patience=5),
    "authors": Protocol(resize=RESIZE_OF_PROTOCOL["authors"]),
}
"""`default` and `paper` keep the policy with the best success rate on validation.

`default` trains for the method's whole budget, and shrinks pictures without losing walls. `paper`
resizes the authors' thin walls as they do, without antialiasing, so that most walls vanish. It
stops training like the authors' public script for BC: after five evaluations on the validation
labyrinths, ten epochs apart, without a better success rate, or after the method's epochs (a
thousand in that script). Here the other methods follow the same rule. `authors` is for the six
methods of the authors' later code, which have their own settings and selection, and are in
scripts/studies/methods/authors.
"""


@dataclass(frozen=True)
class TrainingOptions(SourceOptions, RunFolderOption):
    """What is trained, on what, and where; the method itself checks its settings."""

    method: dict[str, Any] = option(  # noqa: RUF009
        {"name": "bc"},
        f"{', '.join(METHODS)}, or custom with method._target_=module.Class; with settings such as "
        "method.epochs=...",
    )
    encoder: str = option(
        "cnn",
        f"network that encodes the observation: {', '.join(ENCODERS)}; {', '.join(OWN)} have "
        "their own",
        one_of=ENCODERS,
    )
    observation: str = option(
        "image",
        "input of the policy: image, vector (for encoder=mlp), or text (only for policy=...)",
    )
    protocol: str = option(
        "default",
        "default, paper (resizes and stops as in the paper), or authors (for the methods of the "
        "authors' code)",
        one_of=PROTOCOLS,
    )
    train_labyrinths: int | str | None = option(
        None,
        "number of labyrinths to learn from, the first ones of train (all), or fresh for new ones "
        "in each epoch",
        at_least=1,
        one_of=(FRESH,),
    )
    device: str = option(
        "auto",
        "device of the networks: auto (a GPU if there is one), cpu, cuda",
        one_of=("auto", "cpu", "cuda"),
    )
    threads: int | None = option(
        None, "CPU threads of the networks (all cores)", at_least=1, at_most=1_000
    )

    @property
    def method_name(self) -> str:
        """The method's name in records: `bc`, or `mine:Method` for the class `mine.Method`."""
        return str(self.method.get("name", ""))

    @property
    def method_title(self) -> str:
        """The method's name in tables: its class, or its module if the class is `Method`."""
        return RunName.title_of(self.method_name)

    @property
    def first_labyrinths(self) -> int | None:
        """The number of the first labyrinths of train, if the run learns from these alone."""
        return self.train_labyrinths if isinstance(self.train_labyrinths, int) else None

    @property
    def network(self) -> str:
        """The encoder of the policy, or the name of a method that has a network of its own."""
        if ":" in self.method_name:
            given = f"method._target_={target_of(self.method_name)}"
            own = bool(getattr(named(given, self.method_name), "own_network", False))
        else:
            own = self.method_name in OWN
        return self.method_title if own else self.encoder


NEEDS = ("matplotlib", "safetensors", "torch")
"""The libraries of the extra `train`."""


def target_of(name: str) -> str:
    """Return the dotted name of the class of a method, by the method's name in records."""
    return f"{OURS}.{name}.Method" if name in METHODS else name.replace(":", ".")


def check_observation(name: str) -> None:
    """Raise a ConfigError if the library has no such observation."""
    from labyrinth_core.pictures.observations import KINDS

    known = ("image", *KINDS)
    check(name in known, f"observation={name}: choose one of {listed(known)}")


def check_training(options: TrainingOptions) -> None:
    """Raise a ConfigError if an option for training is invalid, or a library is missing."""
    missing = [name for name in NEEDS if find_spec(name) is None]
    install = "pip install 'labyrinth-datasets[train]'"
    check(not missing, f"training needs {', '.join(missing)}: {install}")
    name, seen = options.method_name, options.observation
    check_method(options)
    check_options(options, TrainingOptions)
    check_observation(seen)
    check(
        seen in ("image", "vector"),
        f"observation={seen} is only for policy=...: give image or vector",
    )
    fitting = [encoder for encoder, sees in ENCODERS.items() if sees == seen]
    check(
        options.encoder in fitting,
        f"encoder={options.encoder} looks at observation={ENCODERS[options.encoder]}: for "
        f"observation={seen} choose one of {listed(fitting)}",
    )
    check(
        options.network == options.encoder or seen == "image",
        f"method={name} learns from pictures: leave observation=image",
    )


def check_method(options: TrainingOptions) -> None:
    """Raise a ConfigError unless `method` is in `METHODS` or has the form `module:Class`."""
    name = options.method_name
    check(
        name in METHODS or re.fullmatch(r"\w[\w.]*:\w[\w.]*", name) is not None,
        f"method={name}: choose one of {listed(METHODS)}, or give module:Class of your own",
    )


def named(given: str, name: str) -> Any:
    """Import and return the object `module:name`, from the working directory or as installed.

    Args:
        given: The option that names the object, as typed, for the error message.
        name: The module and, after a colon, the name in it, which may have dots.

    Raises:
        ConfigError: The module, or the name in it, does not exist.
    """
    from labyrinth_core.policies.opening import PolicyNameError, imported

    try:
        return imported(name)
    except PolicyNameError as error:
        raise ConfigError(f"{given}: {error}") from error


def check_run(run: RunName, observation: str) -> None:
    """Raise a ConfigError if no method makes a run of this name with this observation."""
    check(run.protocol in PROTOCOLS, f"protocol={run.protocol}: choose from {', '.join(PROTOCOLS)}")
    ours = run.method in METHODS
    own = {run.method: "image"} if run.method in OWN or not ours else {}
    encoders = own if run.method in OWN else ENCODERS | own
    check(run.encoder in encoders, f"encoder={run.encoder}: choose from {', '.join(encoders)}")
    seen = encoders[run.encoder]
    check(observation == seen, f"observation={observation}: encoder={run.encoder} looks at {seen}")


def run_name(job: Job[TrainingOptions]) -> RunName:
    """Return the name that distinguishes a training run from others on the same dataset."""
    options = job.options
    return RunName(
        method=options.method_title,
        encoder=options.network,
        protocol=options.protocol,
        train_labyrinths=options.train_labyrinths,
        seed=job.dataset.seed,
    )


def training_folder(job: Job[TrainingOptions]) -> Path:
    """Return the folder of a trained policy."""
    return Path(job.options.run_dir).expanduser() / job.dataset.name / run_name(job).name
