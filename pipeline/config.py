"""The configuration: its schema, its checks, and the plain frozen objects made from it.

Hydra and OmegaConf stop here: `resolve` gives objects that the rest of the pipeline trusts.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.errors import MissingConfigException

from labyrinth_core.grid import parse_size
from labyrinth_core.labyrinth import Task
from labyrinth_core.renderer import MAX_PICTURED_SIDE, PICTURE_SIZE
from labyrinth_core.sampling import ALGORITHMS, default_open_walls
from pipeline.storage import AnyPath, RemotePath, folder_at
from pipeline.training_config import (
    TRAINING_OPTIONS,
    TrainingConfig,
    TrainingOptions,
    resolve_training,
)

STAGES = {
    "build": "pipeline.generation.build",
    "validate": "pipeline.generation.validate",
    "analyse": "pipeline.analysis.analyse",
    "card": "pipeline.release.card",
    "report": "pipeline.analysis.report",
    "publish": "pipeline.release.publish",
    "train": "pipeline.training.train",
    "evaluate": "pipeline.training.evaluate",
    "results": "pipeline.training.results",
    "environments": "pipeline.analysis.environments",
}
"""Stage -> the module whose `run` performs it."""

TRAINING_STAGES = {"train", "evaluate", "results"}

SOLUTIONS = ("shortest", "all_shortest", "all")

LABYRINTH = "Labyrinth"
ENVIRONMENTS = (
    LABYRINTH,
    "MountainCar-v0",
    "CartPole-v1",
    "Hopper-v5",
    "Walker2d-v5",
    "HalfCheetah-v5",
)
"""What the stage `environments` compares: labyrinths, and environments of Gymnasium."""

EXECUTORS = ("local", "dask", "ray")

MAX_WORKERS = 1_000
"""More processes than one machine has cores for, and fewer than it refuses to start."""


class ConfigError(ValueError):
    """A value of the configuration that cannot be; its text is one line for the person."""


@dataclass
class TaskConfig:
    """The schema of the group `task`."""

    name: str = "navigation"


@dataclass
class BucketsConfig:
    """Percent of all structures that may be in each split; the same for datasets to compare."""

    train: int = 34
    validation: int = 33
    test: int = 33


@dataclass
class SplitsConfig:
    """How far apart the splits are."""

    min_walls: int = 1


@dataclass
class LeakageConfig:
    """A dataset from elsewhere, for the stage `analyse`."""

    source: str | None = None
    config: str | None = None


@dataclass
class PublishConfig:
    """The schema of `publish`, for the stage of that name."""

    repo_id: str | None = None
    version: str | None = None
    dry_run: bool = False
    private: bool = False
    branch: str = "main"
    create_pr: bool = False
    collection: str | None = None


@dataclass
class AnalysisConfig:
    """The schema of `analysis`."""

    seeds: int = 1000
    environments: list[str] = field(default_factory=lambda: list(ENVIRONMENTS))
    experts: list[str] = field(default_factory=list)
    folder: str = "results/environments"


@dataclass
class RunConfig(TrainingConfig):
    """The schema of `conf/config.yaml`; `OPTIONS` explains each field."""

    stages: list[str] = field(default_factory=list)
    size: str = "5"
    labyrinths: int | None = None
    solutions: str = "shortest"
    solutions_limit: int = 1000
    random_steps: int = 100
    sampler: str = "wilson"
    open_walls: float | None = None
    buckets: BucketsConfig = field(default_factory=BucketsConfig)
    splits: SplitsConfig = field(default_factory=SplitsConfig)
    seed: int = 0
    data_dir: str = ""
    overwrite: bool = False
    workers: int = 1
    executor: str = "local"
    executor_address: str | None = None
    task: TaskConfig = field(default_factory=TaskConfig)
    leakage: LeakageConfig = field(default_factory=LeakageConfig)
    publish: PublishConfig = field(default_factory=PublishConfig)
    analysis: AnalysisConfig = field(default_factory=AnalysisConfig)


OPTIONS = {
    "size": "rows and columns: 5, or height x width such as 4x6",
    "task": "navigation, partial_observability, key_and_door or icy_floor",
    "labyrinths": "labyrinths in each of train, validation and test (32 at 3x3, else 100)",
    "solutions": "routes a labyrinth: shortest (one), all_shortest, all (every simple route)",
    "solutions_limit": "most routes a labyrinth, for all_shortest and all",
    "random_steps": "steps of the random policy a labyrinth, in the split random",
    "sampler": "spanning tree a structure starts from: " + ", ".join(ALGORITHMS),
    "open_walls": "probability of opening each wall that the tree leaves",
    "buckets": "percent of all structures that may be in each split (buckets.train=...)",
    "splits.min_walls": "least number of walls between structures of two splits (1: not equal)",
    "seed": "same seed and options, same bytes; in training, same weights",
    "data_dir": "folder of the dataset, or a URL such as s3://bucket/name; each size and task is a "
    "folder in it",
    "overwrite": "replace a finished dataset or run that was made with other options",
    "workers": "processes",
    "executor": "who runs them: local (this machine), dask or ray",
    "executor_address": "of a running cluster of Dask or Ray; else one is started for the run",
    "stages": "what to do, in order: " + ", ".join(STAGES),
    **TRAINING_OPTIONS,
    "leakage.source": "dataset from elsewhere to analyse: a folder of .labyrinth files by split, "
    "or any folder or id on the Hub with the five columns",
    "leakage.config": "config of that dataset, if it has several",
    "publish.repo_id": "dataset on the Hub, such as user/labyrinth",
    "publish.version": "tag of the release, such as 1.0.0",
    "publish.dry_run": "say what would be added, kept and deleted, and change nothing",
    "publish.private": "make the dataset private, if it has to be made",
    "publish.branch": "branch to release on",
    "publish.create_pr": "open a pull request instead",
    "publish.collection": "title of a collection on the Hub that the dataset joins",
    "analysis.seeds": "episodes of each environment; the original has 100000",
    "analysis.environments": "which: " + ", ".join(ENVIRONMENTS),
    "analysis.experts": "Stable-Baselines3 archives to take as experts, [Hopper-v5:path or Hub id]",
    "analysis.folder": "where the stage environments leaves its tables and pictures",
}
"""What each option means, as `python run.py --help` and the README say it."""


@dataclass(frozen=True)
class DatasetConfig:
    """All that determines the rows of a dataset, and nothing else; kept in its manifest."""

    height: int
    width: int
    task: Task
    labyrinths: int
    solutions: str
    solutions_limit: int
    random_steps: int
    sampler: str
    open_walls: float
    buckets: tuple[int, int, int]
    """Percent of all structures that may be in train, validation and test."""
    seed: int
    min_walls: int = 1
    """How many walls structures of two splits are apart, at least."""

    @property
    def name(self) -> str:
        """The name of its config on the Hub and of its folder, such as `5x5-key_and_door`."""
        suffix = "" if self.task is Task.NAVIGATION else f"-{self.task}"
        return f"{self.height}x{self.width}{suffix}"

    def to_json(self) -> dict[str, Any]:
        """Return it in plain types; `from_json` is the inverse.

        Datasets from before there was a `min_walls` have none, and those that do not use it
        neither, so that they are the same.
        """
        plain = asdict(self) | {"task": str(self.task), "buckets": list(self.buckets)}
        return {name: plain[name] for name in plain if (name, plain[name]) != ("min_walls", 1)}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> DatasetConfig:
        """Return the config that `to_json` described.

        Raises:
            ValueError: A field is missing, unknown, of the wrong kind, or impossible.
        """
        plain = {"min_walls": 1} | dict(values)
        like = _resolve_dataset(RunConfig()).to_json() | {"min_walls": 1}
        if _kinds(plain) != _kinds(like):
            raise ValueError(f"a dataset's config has the fields {like}, not {plain}")
        size = f"{plain.pop('height')}x{plain.pop('width')}"
        buckets = BucketsConfig(*plain.pop("buckets"))
        task = TaskConfig(plain.pop("task"))
        splits = SplitsConfig(plain.pop("min_walls"))
        return _resolve_dataset(
            RunConfig(size=size, buckets=buckets, task=task, splits=splits, **plain)
        )


@dataclass(frozen=True)
class LeakageOptions:
    """Which dataset from elsewhere to analyse, None for that of the run."""

    source: str | None
    config: str | None


@dataclass(frozen=True)
class PublishOptions:
    """Where and how to publish, checked."""

    repo_id: str
    version: str
    dry_run: bool = False
    private: bool = False
    branch: str = "main"
    create_pr: bool = False
    collection: str | None = None


@dataclass(frozen=True)
class AnalysisOptions:
    """Which environments to compare, on how many episodes, checked."""

    seeds: int
    environments: tuple[str, ...]
    experts: Mapping[str, str]
    """Environment -> Stable-Baselines3 archive to take instead of our expert."""
    folder: Path


@dataclass(frozen=True)
class Run:
    """One run of the pipeline, checked."""

    stages: tuple[str, ...]
    dataset: DatasetConfig
    data_dir: AnyPath
    overwrite: bool
    workers: int
    leakage: LeakageOptions
    run_dir: Path
    """Folder of the training runs."""
    executor: str = "local"
    executor_address: str | None = None
    publish: PublishOptions | None = None
    """None unless the stage `publish` is asked for."""
    training: TrainingOptions | None = None
    """None unless a stage of training is asked for."""
    analysis: AnalysisOptions | None = None
    """None unless the stage `environments` is asked for."""

    @property
    def local_dir(self) -> Path:
        """The data_dir, for stages that `resolve` lets have a local one only."""
        assert isinstance(self.data_dir, Path)
        return self.data_dir

    @property
    def folder(self) -> AnyPath:
        """Where the dataset of this run lies."""
        return self.data_dir / self.dataset.name


_HELP = """Make a dataset of labyrinths: unique, solved optimally, pictured, in Parquet shards.
Train a policy on it.

    python run.py size=5
    python run.py size=5 stages=[train,evaluate] method=bc encoder=cnn seed=0
    python run.py stages=[results]
    python run.py size=4x6 task=key_and_door labyrinths=1000 workers=2
    python run.py -m size=3,4,5

Options, each as name=value:

{options}

--cfg job prints the values that a command line gives, --hydra-help the flags of Hydra itself.
"""


def register() -> None:
    """Tell Hydra the schema and the text of `--help`."""
    width = max(map(len, OPTIONS))
    options = "\n".join(f"  {name:{width}}  {meaning}" for name, meaning in OPTIONS.items())
    store = ConfigStore.instance()
    store.store(name="schema", node=RunConfig)
    store.store(
        group="hydra/help", name="options", node={"template": _HELP.format(options=options)}
    )


def one_line(error: Exception) -> str:
    """Return what is wrong with a command line that Hydra refused, in one line."""
    if isinstance(error, MissingConfigException) and error.missing_cfg_file and error.options:
        group, _, given = error.missing_cfg_file.partition("/")
        return f"{group}={given}: choose one of {_listed(error.options)}"
    text = str(error.__cause__ or error)
    unknown = re.search(r"(?:Could not override|Key) '([^'=]*)'", f"{error} {text}")
    if unknown:
        close = difflib.get_close_matches(unknown[1], OPTIONS, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        return f"{unknown[1]} is no option: {hint}choose from {_listed(OPTIONS)}"
    field_name = re.search(r"full_key: (\S+)", text)
    message = " ".join(text.split("full_key")[0].split())
    return f"{field_name[1]}: {message}" if field_name else message


def resolve(config: RunConfig) -> Run:
    """Return the run that a configuration asks for.

    Args:
        config: As composed by Hydra, or a `RunConfig`.

    Raises:
        ConfigError: A value is impossible; the text says what was given and what is allowed.
    """
    _check_fields(config, "", vars(RunConfig()))
    _check_fields(config.buckets, "buckets.", vars(BucketsConfig()))
    _check_fields(config.task, "task.", vars(TaskConfig()))
    _check_fields(config.splits, "splits.", vars(SplitsConfig()))
    _check_fields(config.leakage, "leakage.", vars(LeakageConfig()))
    _check_fields(config.publish, "publish.", vars(PublishConfig()))
    _check_fields(config.analysis, "analysis.", vars(AnalysisConfig()))
    unknown = [stage for stage in config.stages if stage not in STAGES]
    _check(
        not unknown and len(config.stages) > 0,
        f"stages={_listed(config.stages)}: choose from {_listed(STAGES)}",
    )
    _check(
        1 <= config.workers <= MAX_WORKERS,
        f"workers={config.workers}: give a number from 1 to {MAX_WORKERS:,}",
    )
    for name in ("data_dir", "run_dir"):
        _check(getattr(config, name).strip() != "", f"{name} is empty: give a folder")
    _check(
        config.executor in EXECUTORS,
        f"executor={config.executor}: choose one of {_listed(EXECUTORS)}",
    )
    _check(
        config.executor_address is None or config.executor != "local",
        f"executor_address={config.executor_address}: executor=local has none",
    )
    return Run(
        stages=tuple(config.stages),
        dataset=_resolve_dataset(config),
        data_dir=_resolve_data_dir(config),
        overwrite=config.overwrite,
        workers=config.workers,
        leakage=LeakageOptions(config.leakage.source, config.leakage.config),
        run_dir=Path(config.run_dir).expanduser(),
        executor=config.executor,
        executor_address=config.executor_address,
        publish=_resolve_publish(config.publish) if "publish" in config.stages else None,
        training=_resolve_training(config) if TRAINING_STAGES & set(config.stages) else None,
        analysis=_resolve_analysis(config.analysis) if "environments" in config.stages else None,
    )


def _resolve_training(config: RunConfig) -> TrainingOptions:
    try:
        return resolve_training(config, str(folder_at(config.data_dir)), config.seed)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _resolve_data_dir(config: RunConfig) -> AnyPath:
    try:
        folder = folder_at(config.data_dir)
    except ValueError as error:
        raise ConfigError(f"data_dir={error}") from error
    if isinstance(folder, RemotePath):
        for stage in ("report", "publish"):
            _check(stage not in config.stages, f"data_dir={folder}: {stage} needs a local folder")
        return folder
    # Workers of a cluster need not be where this process is.
    return folder if config.executor == "local" else folder.absolute()


def _resolve_publish(config: PublishConfig) -> PublishOptions:
    repo_id, version = config.repo_id or "", config.version or ""
    _check(
        re.fullmatch(r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*", repo_id, re.ASCII) is not None,
        f"publish.repo_id={repo_id}: give the id of the dataset on the Hub, such as user/labyrinth",
    )
    _check(
        re.fullmatch(r"\d+\.\d+\.\d+", version, re.ASCII) is not None,
        f"publish.version={version}: give three numbers, such as 1.0.0",
    )
    _check(
        re.fullmatch(r"[\w./-]+", config.branch, re.ASCII) is not None,
        f"publish.branch={config.branch}: give the name of a branch, such as main",
    )
    return PublishOptions(**vars(config) | {"repo_id": repo_id, "version": version})


def _resolve_analysis(config: AnalysisConfig) -> AnalysisOptions:
    _check(4 <= config.seeds <= 10**9, f"analysis.seeds={config.seeds}: give 4 to 1,000,000,000")
    unknown = [name for name in config.environments if name not in ENVIRONMENTS]
    _check(
        not unknown and len(config.environments) > 0,
        f"analysis.environments={_listed(config.environments)}: "
        f"choose from {_listed(ENVIRONMENTS)}",
    )
    experts = dict(expert.partition(":")[::2] for expert in config.experts)
    _check(
        all(name in ENVIRONMENTS[1:] and archive for name, archive in experts.items()),
        f"analysis.experts={_listed(config.experts)}: give environment:archive, "
        f"the environment one of {_listed(ENVIRONMENTS[1:])}",
    )
    _check(config.folder.strip() != "", "analysis.folder is empty: give a folder")
    return AnalysisOptions(
        seeds=config.seeds,
        environments=tuple(dict.fromkeys(config.environments)),
        experts=experts,
        folder=Path(config.folder).expanduser(),
    )


def _resolve_dataset(config: RunConfig) -> DatasetConfig:
    try:
        height, width = parse_size(config.size)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    _check(
        max(height, width) <= MAX_PICTURED_SIDE,
        f"size={config.size}: {MAX_PICTURED_SIDE} rows and columns at most fit the datasets' "
        f"pictures of {PICTURE_SIZE} x {PICTURE_SIZE} pixels",
    )
    labyrinths = config.labyrinths
    if labyrinths is None:
        labyrinths = 32 if (height, width) == (3, 3) else 100
    open_walls = config.open_walls
    if open_walls is None:
        open_walls = default_open_walls(height, width)
    buckets = (config.buckets.train, config.buckets.validation, config.buckets.test)
    tasks = [str(task) for task in Task]
    _check(config.task.name in tasks, f"task={config.task.name}: choose one of {_listed(tasks)}")
    _check(labyrinths >= 1, f"labyrinths={labyrinths}: give 1 or more")
    _check(
        config.solutions in SOLUTIONS,
        f"solutions={config.solutions}: choose one of {_listed(SOLUTIONS)}",
    )
    _check(config.solutions_limit >= 1, f"solutions_limit={config.solutions_limit}: give 1 or more")
    _check(config.random_steps >= 1, f"random_steps={config.random_steps}: give 1 or more")
    _check(
        config.sampler in ALGORITHMS,
        f"sampler={config.sampler}: choose one of {_listed(ALGORITHMS)}",
    )
    _check(0 <= open_walls <= 1, f"open_walls={open_walls}: give a probability from 0 to 1")
    _check(
        min(buckets) >= 1 and sum(buckets) == 100,
        f"buckets={_listed(map(str, buckets))}: give three percentages of 1 or more "
        "that add up to 100",
    )
    _check(0 <= config.seed < 2**64, f"seed={config.seed}: give 0 or more, below 2**64")
    passages = 2 * height * width - height - width
    _check(
        1 <= config.splits.min_walls <= passages,
        f"splits.min_walls={config.splits.min_walls}: give 1 to {passages}, "
        f"as many as walls there can be at {height}x{width}",
    )
    return DatasetConfig(
        height=height,
        width=width,
        task=Task(config.task.name),
        labyrinths=labyrinths,
        solutions=config.solutions,
        solutions_limit=config.solutions_limit,
        random_steps=config.random_steps,
        sampler=config.sampler,
        open_walls=float(open_walls),
        buckets=buckets,
        seed=config.seed,
        min_walls=config.splits.min_walls,
    )


def _check_fields(values: object, prefix: str, allowed: Iterable[str]) -> None:
    added = sorted(set(vars(values)) - set(allowed))
    names = ", ".join(prefix + name for name in added)
    _check(not added, f"{names}: no options; choose from {_listed(allowed)}")


def _kinds(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the type of each value, of a list those of its items."""
    return {
        name: [type(item) for item in value] if isinstance(value, list) else type(value)
        for name, value in values.items()
    }


def _check(holds: bool, message: str) -> None:
    if not holds:
        raise ConfigError(message)


def _listed(words: Any) -> str:
    return "[" + ", ".join(words) + "]"
