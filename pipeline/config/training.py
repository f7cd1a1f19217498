"""The options that name a training run: what is trained, on what, and where.

This module does not import torch, so that `labyrinth-datasets --help` stays quick.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from labyrinth_core.data import DatasetConfig
from labyrinth_core.evaluation import RunName
from labyrinth_core.learning import NetworkSpec
from pipeline.config.errors import ConfigError, check, listed
from pipeline.config.option import check_options, option
from pipeline.config.options import RunFolderOption, SourceOptions

METHODS = ("bc", "dagger", "gail", "bco", "sqil", "iupe", "planner", "mapper")
"""The modules of the methods in the package `_OURS`, and their files in `conf/method`."""

_OURS = "labyrinth_core.learning.methods"
_FORMERLY = "pipeline.training.methods"
"""The package of the methods in the `config.yaml` of earlier runs."""

NEEDS = ("matplotlib", "safetensors", "torch")
"""The libraries of the extra `train`."""


_RESIZES = {"default": "area", "paper": "original", "authors": "original"}
"""Protocol -> how pictures are made smaller, one of `pictures.observations.RESIZES`."""


def target_of(name: str) -> str:
    """Return the dotted name of the class of a method, by the method's name in records."""
    return f"{_OURS}.{name}.Method" if name in METHODS else name.replace(":", ".")


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
        f"network that encodes the observation: {', '.join(NetworkSpec.ENCODERS)}; "
        f"{', '.join(NetworkSpec.OWN)} have their own",
        one_of=NetworkSpec.ENCODERS,
    )
    observation: str = option(
        "image",
        "input of the policy: image, vector (for encoder=mlp), or text (only for policy=...)",
    )
    protocol: str = option(
        "default",
        "default, paper (resizes and stops as in the paper), or authors (for the methods of the "
        "authors' code)",
        one_of=_RESIZES,
    )
    train_labyrinths: int | str | None = option(
        None,
        "number of labyrinths to learn from, the first ones of train (all), or fresh for new ones "
        "in each epoch",
        at_least=1,
        one_of=(RunName.FRESH,),
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
            own = bool(getattr(self.users_method(), "own_network", False))
        else:
            own = self.method_name in NetworkSpec.OWN
        return self.method_title if own else self.encoder

    @property
    def is_network_known(self) -> bool:
        """Whether the library can make the network, so that it can open the policy."""
        return self.network in (*NetworkSpec.ENCODERS, *NetworkSpec.OWN)

    @property
    def resize(self) -> str:
        """How the protocol shrinks pictures: one of `pictures.observations.RESIZES`."""
        return _RESIZES[self.protocol]

    def users_method(self) -> Any:
        """Import and return the user's object `module:Class`, from the working directory or else.

        Raises:
            ConfigError: The module, or the name in it, does not exist.
        """
        from labyrinth_core.policies import PolicyNameError, imported

        try:
            return imported(self.method_name)
        except PolicyNameError as error:
            raise ConfigError(f"method._target_={target_of(self.method_name)}: {error}") from error

    def run_name(self, dataset: DatasetConfig) -> RunName:
        """Return the name that distinguishes a training run from others on the same dataset."""
        return RunName(
            method=self.method_title,
            encoder=self.network,
            protocol=self.protocol,
            train_labyrinths=self.train_labyrinths,
            seed=dataset.seed,
        )

    def run_folder(self, dataset: DatasetConfig) -> Path:
        """Return the folder of a trained policy."""
        return Path(self.run_dir).expanduser() / dataset.name / self.run_name(dataset).name

    @staticmethod
    def name_of(target: str) -> str:
        """Return the name in records of the method whose class has this dotted name."""
        module, _, name = target.rpartition(".")
        ours = module.removeprefix(f"{_OURS}.").removeprefix(f"{_FORMERLY}.")
        if name == "Method" and ours in METHODS and module != ours:
            return ours
        above, _, last = module.rpartition(".")
        while above and last[:1].isupper():  # The class is within another class.
            module, name = above, f"{last}.{name}"
            above, _, last = module.rpartition(".")
        return f"{module}:{name}"

    def check_observation(self) -> None:
        """Raise a ConfigError if the library has no such observation."""
        from labyrinth_core.pictures import OBSERVATIONS

        seen = self.observation
        check(seen in OBSERVATIONS, f"observation={seen}: choose one of {listed(OBSERVATIONS)}")

    def check_training(self) -> None:
        """Raise a ConfigError if an option for training is invalid, or a library is missing."""
        missing = [name for name in NEEDS if find_spec(name) is None]
        install = "pip install 'labyrinth-datasets[train]'"
        check(not missing, f"training needs {', '.join(missing)}: {install}")
        name, seen = self.method_name, self.observation
        check(
            name in METHODS or re.fullmatch(r"\w[\w.]*:\w[\w.]*", name) is not None,
            f"method={name}: choose one of {listed(METHODS)}, or give module:Class of your own",
        )
        check_options(self, TrainingOptions)
        self.check_observation()
        check(
            seen in ("image", "vector"),
            f"observation={seen} is only for policy=...: give image or vector",
        )
        fitting = [encoder for encoder, sees in NetworkSpec.ENCODERS.items() if sees == seen]
        check(
            self.encoder in fitting,
            f"encoder={self.encoder} looks at observation={NetworkSpec.ENCODERS[self.encoder]}: "
            f"for observation={seen} choose one of {listed(fitting)}",
        )
        check(
            self.network == self.encoder or seen == "image",
            f"method={name} learns from pictures: leave observation=image",
        )

    @staticmethod
    def check_run(run: RunName, observation: str) -> None:
        """Raise a ConfigError if no method makes a run of this name with this observation."""
        known = ", ".join(_RESIZES)
        check(run.protocol in _RESIZES, f"protocol={run.protocol}: choose from {known}")
        ours = run.method in METHODS
        has_own = run.method in NetworkSpec.OWN
        own = {run.method: "image"} if has_own or not ours else {}
        encoders = own if has_own else {**NetworkSpec.ENCODERS, **own}
        check(run.encoder in encoders, f"encoder={run.encoder}: choose from {', '.join(encoders)}")
        seen = encoders[run.encoder]
        check(
            observation == seen, f"observation={observation}: encoder={run.encoder} looks at {seen}"
        )
