"""The options that several stages share, such as those that name a training run or an export.

A stage's own are in the `options.py` of its wing. This module does not import torch, so that
`labyrinth-datasets --help` stays quick.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

from labyrinth_core.data import SPLITS, DatasetConfig
from labyrinth_core.evaluation import RunName
from labyrinth_core.learning import NetworkSpec
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE, PICTURE_SIZE
from pipeline.config.declaration import ConfigError, check, check_options, listed, option


@dataclass(frozen=True)
class WorkOptions:
    """How and where a stage works, and whether it replaces what was made with other options."""

    overwrite: bool = option(
        False, "replace a finished dataset, run or export that was made with other options"
    )
    workers: int = option(1, "number of processes", at_least=1, at_most=1_000)
    executor: str = option(
        "local",
        "where processes run: local (this machine), dask (a new Dask cluster), or the address of a "
        "running one, such as tcp://host:8786",
        like=(
            r"local|dask|\S+:\S+",
            "local, dask, or the address of a Dask cluster, such as tcp://host:8786",
        ),
    )


@dataclass(frozen=True)
class SourceOptions:
    """Another dataset than the one in `data_dir`."""

    dataset: str | None = option(
        None,
        "dataset to use instead of data_dir: an id on the Hub, such as user/labyrinth, or a folder",
    )
    revision: str | None = option(None, "branch, tag or commit of the dataset on the Hub")


@dataclass(frozen=True)
class RunFolderOption:
    """Where trained policies are."""

    run_dir: str = option(
        "runs",
        "folder of trained policies; each size and task has a subfolder",
        is_local_folder=True,
    )


@dataclass(frozen=True)
class ResultsFolderOption:
    """Where the tables of results are."""

    results_dir: str = option(
        "results",
        "folder of the evaluations, and of the tables made from them",
        is_local_folder=True,
    )
    SUBMISSIONS: ClassVar = "submissions"
    """The subfolder for the results of submitted policies."""


@dataclass(frozen=True)
class ResultFolderOptions(RunFolderOption, ResultsFolderOption):
    """Where trained policies are, and the tables of results."""


@dataclass(frozen=True)
class ExportOptions:
    """The format and the folder of an export for another library."""

    FORMATS: ClassVar = {
        "minari": "pipeline.export.minari",
        "imitation": "pipeline.export.imitation",
        "lerobot": "pipeline.export.lerobot",
    }
    """Format -> the module whose `write` exports a split."""

    format: str = option("", "library to export for: " + ", ".join(FORMATS), one_of=FORMATS)
    folder: str = option(
        "exports", "folder of the exports, with a subfolder for each format", is_local_folder=True
    )
    splits: tuple[str, ...] = option((), "splits to export, one or a list (all)", one_of=SPLITS)
    image_size: int = option(
        DEFAULT_IMAGE_SIZE, "pixels on each side of the pictures", at_least=1, at_most=PICTURE_SIZE
    )

    RELEASED: ClassVar = ("lerobot", "minari")
    """The formats whose libraries read the Hub, so that `publish.export` releases them."""
    NAMESPACE: ClassVar = "labyrinth"
    VERSION: ClassVar = 0
    """The first and the last part of every export's name; they never change."""
    RECORD: ClassVar = "labyrinth.json"
    """The file in each export's folder that says what the export was made from."""
    CODEBASE_VERSION: ClassVar = "v3.0"
    """The version of LeRobot's format, which is also the tag on the Hub that LeRobot reads."""

    @property
    def module(self) -> str:
        """The module whose `write` exports a split in the format."""
        return self.FORMATS[self.format]

    def path(self, config: str) -> Path:
        """Return the folder of the exports of a dataset's config, with a subfolder a split."""
        return Path(self.folder).expanduser() / self.format / self.NAMESPACE / config

    def check(self) -> None:
        """Raise a ConfigError if an option is invalid."""
        check_options(self, ExportOptions, "export.")

    def check_splits(self, known: Sequence[str]) -> None:
        """Raise a ConfigError if a split is not among those of the dataset."""
        check(
            {*self.splits} <= {*known},
            f"export.splits={listed(self.splits)}: choose from {listed(known)}",
        )


_OURS = "labyrinth_core.learning.methods"
_FORMERLY = "pipeline.training.methods"
"""The package of the methods in the `config.yaml` of earlier runs."""

NEEDS = ("matplotlib", "safetensors", "torch")
"""The libraries of the extra `train`."""


_RESIZES = {"default": "area", "paper": "original", "authors": "original"}
"""Protocol -> how pictures are made smaller, one of `pictures.observations.RESIZES`."""


@dataclass(frozen=True)
class TrainingOptions(SourceOptions, RunFolderOption):
    """What is trained, on what, and where; the method itself checks its settings."""

    METHODS: ClassVar = ("bc", "dagger", "gail", "bco", "sqil", "iupe", "planner", "mapper")
    """The modules of the methods in the package `_OURS`, and their files in `conf/method`."""

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
            raise ConfigError(
                f"method._target_={self.target_of(self.method_name)}: {error}"
            ) from error

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

    @classmethod
    def target_of(cls, name: str) -> str:
        """Return the dotted name of the class of a method, by the method's name in records."""
        return f"{_OURS}.{name}.Method" if name in cls.METHODS else name.replace(":", ".")

    @classmethod
    def name_of(cls, target: str) -> str:
        """Return the name in records of the method whose class has this dotted name."""
        module, _, name = target.rpartition(".")
        ours = module.removeprefix(f"{_OURS}.").removeprefix(f"{_FORMERLY}.")
        if name == "Method" and ours in cls.METHODS and module != ours:
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
            name in self.METHODS or re.fullmatch(r"\w[\w.]*:\w[\w.]*", name) is not None,
            f"method={name}: choose one of {listed(self.METHODS)}, or give module:Class of your "
            "own",
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

    @classmethod
    def check_run(cls, run: RunName, observation: str) -> None:
        """Raise a ConfigError if no method makes a run of this name with this observation."""
        known = ", ".join(_RESIZES)
        check(run.protocol in _RESIZES, f"protocol={run.protocol}: choose from {known}")
        ours = run.method in cls.METHODS
        has_own = run.method in NetworkSpec.OWN
        own = {run.method: "image"} if has_own or not ours else {}
        encoders = own if has_own else {**NetworkSpec.ENCODERS, **own}
        check(run.encoder in encoders, f"encoder={run.encoder}: choose from {', '.join(encoders)}")
        seen = encoders[run.encoder]
        check(
            observation == seen, f"observation={observation}: encoder={run.encoder} looks at {seen}"
        )
