"""The configuration: its schema, its checks, and the plain frozen objects made from it.

Hydra and OmegaConf stop here: `resolve` gives objects that the rest of the pipeline trusts.
"""

from __future__ import annotations

import difflib
import re
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path

from hydra.core.config_store import ConfigStore
from hydra.errors import MissingConfigException

from labyrinth_core.data.dataset_config import SOLUTIONS, DatasetConfig
from labyrinth_core.data.storage import AnyPath, RemotePath, folder_at
from pipeline.config.analysis import (
    ANALYSIS_OPTIONS,
    AnalysisConfig,
    AnalysisOptions,
    LeakageConfig,
    LeakageOptions,
    resolve_analysis,
)
from pipeline.config.dataset import (
    DATASET_OPTIONS,
    BucketsConfig,
    DatasetSchema,
    SplitsConfig,
    TaskConfig,
    resolve_dataset,
)
from pipeline.config.errors import ConfigError, check, check_choice, check_choices, listed
from pipeline.config.publish import PUBLISH_OPTIONS, PublishConfig, PublishOptions, resolve_publish
from pipeline.config.training import (
    TRAINING_OPTIONS,
    TrainingConfig,
    TrainingOptions,
    resolve_training,
)

__all__ = [
    "MAX_WORKERS",
    "OPTIONS",
    "SOLUTIONS",
    "STAGES",
    "AnalysisConfig",
    "BucketsConfig",
    "ConfigError",
    "DatasetConfig",
    "LeakageConfig",
    "PublishConfig",
    "Run",
    "RunConfig",
    "SplitsConfig",
    "TaskConfig",
    "refusal",
    "register",
    "resolve",
]

STAGES = {
    "build": "pipeline.generation.build",
    "validate": "pipeline.generation.validate",
    "analyse": "pipeline.analysis.analyse",
    "card": "pipeline.release.card",
    "report": "pipeline.analysis.report.stage",
    "publish": "pipeline.release.publish",
    "train": "pipeline.training.train",
    "evaluate": "pipeline.training.evaluate",
    "results": "pipeline.training.results.stage",
    "environments": "pipeline.analysis.environments.stage",
}
"""Stage -> the module whose `run` performs it."""

TRAINING_STAGES = {"train", "evaluate", "results"}

EXECUTORS = ("local", "dask", "ray")

MAX_WORKERS = 1_000
"""More processes than one machine has cores for, and fewer than it refuses to start."""


@dataclass
class RunConfig(TrainingConfig, DatasetSchema):
    """The schema of `conf/config.yaml`; `OPTIONS` explains each field."""

    stages: list[str] = field(default_factory=list)
    data_dir: str = ""
    overwrite: bool = False
    workers: int = 1
    executor: str = "local"
    executor_address: str | None = None
    leakage: LeakageConfig = field(default_factory=LeakageConfig)
    publish: PublishConfig = field(default_factory=PublishConfig)
    analysis: AnalysisConfig = field(default_factory=AnalysisConfig)


SECTIONS = {
    "What the dataset is": DATASET_OPTIONS,
    "Where and how it is made": {
        "data_dir": "folder of the dataset, or a URL such as s3://bucket/name; each size and task "
        "is a folder in it",
        "overwrite": "replace a finished dataset or run that was made with other options",
        "workers": "processes",
        "executor": "who runs them: local (this machine), dask or ray",
        "executor_address": "of a running cluster of Dask or Ray; else one is started for the run",
        "stages": "what to do, in order: " + ", ".join(STAGES),
    },
    "What is trained on it, by stages=[train,evaluate]": TRAINING_OPTIONS,
    "What is analysed, by stages=[analyse] and stages=[environments]": ANALYSIS_OPTIONS,
    "Where it is published, by stages=[publish]": PUBLISH_OPTIONS,
}
"""The options in the order of `--help`, under its headings."""

OPTIONS = {name: meaning for section in SECTIONS.values() for name, meaning in section.items()}
"""What each option means, as `python run.py --help` and the README say it."""


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
    store = ConfigStore.instance()
    store.store(name="schema", node=RunConfig)
    help_text = _HELP.format(options="\n".join(map(_described, SECTIONS)))
    store.store(group="hydra/help", name="options", node={"template": help_text})


def _described(heading: str) -> str:
    """Return a section of `--help`."""
    width = max(map(len, OPTIONS))
    lines = [
        textwrap.fill(
            f"  {name:{width}}  {meaning}",
            100,
            subsequent_indent=" " * (width + 4),
            break_on_hyphens=False,
        )
        for name, meaning in SECTIONS[heading].items()
    ]
    return "\n".join([f"{heading}:", *lines, ""])


def refusal(error: Exception) -> str:
    """Return what is wrong with a command line that Hydra refused, in one line."""
    if isinstance(error, MissingConfigException) and error.missing_cfg_file and error.options:
        group, _, given = error.missing_cfg_file.partition("/")
        return f"{group}={given}: choose one of {listed(error.options)}"
    text = str(error.__cause__ or error)
    unknown = re.search(r"(?:Could not override|Key) '([^'=]*)'", f"{error} {text}")
    if unknown:
        close = difflib.get_close_matches(unknown[1], OPTIONS, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        return f"{unknown[1]} is no option: {hint}choose from {listed(OPTIONS)}"
    field_name = re.search(r"full_key: (\S+)", text)
    message = " ".join(text.partition("full_key")[0].split())
    return f"{field_name[1]}: {message}" if field_name else message


def resolve(config: RunConfig) -> Run:
    """Return the run that a configuration asks for.

    Args:
        config: As composed by Hydra, or a `RunConfig`.

    Raises:
        ConfigError: A value is impossible; the text says what was given and what is allowed.
    """
    schema = vars(RunConfig())
    _check_fields(config, "", schema)
    for name, default in schema.items():
        if is_dataclass(default):
            _check_fields(getattr(config, name), f"{name}.", vars(default))
    check_choices("stages", config.stages, STAGES)
    check(
        1 <= config.workers <= MAX_WORKERS,
        f"workers={config.workers}: give a number from 1 to {MAX_WORKERS:,}",
    )
    for name in ("data_dir", "run_dir"):
        check(getattr(config, name).strip() != "", f"{name} is empty: give a folder")
    check_choice("executor", config.executor, EXECUTORS)
    check(
        config.executor_address is None or config.executor != "local",
        f"executor_address={config.executor_address}: executor=local has none",
    )
    stages = set(config.stages)
    return Run(
        stages=tuple(config.stages),
        dataset=resolve_dataset(config),
        data_dir=_resolve_data_dir(config),
        overwrite=config.overwrite,
        workers=config.workers,
        leakage=LeakageOptions(config.leakage.source, config.leakage.config),
        run_dir=Path(config.run_dir).expanduser(),
        executor=config.executor,
        executor_address=config.executor_address,
        publish=resolve_publish(config.publish) if "publish" in stages else None,
        training=_resolve_training(config) if TRAINING_STAGES & stages else None,
        analysis=resolve_analysis(config.analysis) if "environments" in stages else None,
    )


def _resolve_data_dir(config: RunConfig) -> AnyPath:
    try:
        folder = folder_at(config.data_dir)
    except ValueError as error:
        raise ConfigError(f"data_dir={error}") from error
    if isinstance(folder, RemotePath):
        for stage in ("report", "publish"):
            check(stage not in config.stages, f"data_dir={folder}: {stage} needs a local folder")
        return folder
    # Workers of a cluster need not be where this process is.
    return folder if config.executor == "local" else folder.absolute()


def _resolve_training(config: RunConfig) -> TrainingOptions:
    return resolve_training(config, str(folder_at(config.data_dir)), config.seed)


def _check_fields(values: object, prefix: str, allowed: Iterable[str]) -> None:
    added = sorted(set(vars(values)) - set(allowed))
    names = ", ".join(prefix + name for name in added)
    check(not added, f"{names}: no options; choose from {listed(allowed)}")
