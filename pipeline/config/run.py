"""One run of the program: its options, and the objects made from them.

Hydra and OmegaConf stop here: `resolve` returns an object that the rest of the pipeline trusts.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.manifest import MANIFEST
from labyrinth_core.data.storage import AnyPath, RemotePath, folder_at
from labyrinth_core.evaluation.description import RunName
from pipeline.config.certify import CertifyOptions, check_certify
from pipeline.config.dataset import DatasetOptions, dataset_config
from pipeline.config.errors import ConfigError, check
from pipeline.config.export import NAMESPACE, ExportOptions
from pipeline.config.option import (
    FOLDER,
    LOCAL_FOLDER,
    check_options,
    declared,
    default_of,
    frozen,
    meanings,
    option,
)
from pipeline.config.publish import PublishOptions, check_publish
from pipeline.config.season import SEASON_STAGES, SeasonOptions, check_season
from pipeline.config.training import (
    EvaluationOptions,
    TrainingOptions,
    check_method,
    check_policy,
    check_training,
    check_unnamed,
)

STAGES = {
    "build": "pipeline.generation.build",
    "questions": "pipeline.generation.questions",
    "validate": "pipeline.generation.check",
    "analyse": "pipeline.inspection.analyse",
    "card": "pipeline.release.card",
    "report": "pipeline.report.report",
    "publish": "pipeline.release.publish",
    "export": "pipeline.export.stage",
    "train": "pipeline.training.train",
    "evaluate": "pipeline.evaluation.evaluate",
    "results": "pipeline.results.results",
    "certify": "pipeline.certify.stage",
    "season": "pipeline.season.season",
    "judge": "pipeline.season.judge",
    "reveal": "pipeline.season.reveal",
    "verify": "pipeline.season.verify",
}
"""Stage -> the module whose `run` performs it."""


@dataclass(frozen=True)
class PlaceOptions:
    """Where and how a dataset is made."""

    data_dir: str = option(
        "data/labyrinth",
        "folder of datasets, or a URL such as s3://bucket/name; each size and task has a subfolder",
        like=FOLDER,
    )
    run_dir: str = option(
        "runs", "folder of trained policies; each size and task has a subfolder", like=LOCAL_FOLDER
    )
    overwrite: bool = option(
        False, "replace a finished dataset, run or export that was made with other options"
    )
    grow: bool = option(
        False, "extend a finished dataset to more labyrinths or shifts, in place of the old one"
    )
    workers: int = option(1, "number of processes", at_least=1, at_most=1_000)
    executor: str = option(
        "local", "where processes run: local (this machine) or dask", one_of=("local", "dask")
    )
    executor_address: str | None = option(
        None, "address of a running Dask cluster; without it, one is started for the run"
    )
    part: str = option(
        "",
        "part of a build to make, such as 3/64, while other processes make other parts in the "
        "same data_dir; a last run without part joins them",
        like=(r"(0*([1-9]\d*)/0*([1-9]\d*))?", "the part and the number of parts, such as 3/64"),
    )
    stages: tuple[str, ...] = option(
        ("build", "validate", "analyse", "card"),
        "stages to run, in order: " + ", ".join(STAGES),
        one_of=STAGES,
    )


@dataclass(frozen=True)
class RunConfig(TrainingOptions, PlaceOptions, DatasetOptions):
    """All options, as they are given on a command line."""

    certify: CertifyOptions = field(default_factory=CertifyOptions)
    publish: PublishOptions = field(default_factory=PublishOptions)
    export: ExportOptions = field(default_factory=ExportOptions)
    evaluation: EvaluationOptions = field(default_factory=EvaluationOptions)
    season: SeasonOptions = field(default_factory=SeasonOptions)


SECTIONS = {
    "Dataset": meanings(DatasetOptions),
    "Where and how it is built": meanings(PlaceOptions),
    "Training, by 'stages=[train,evaluate]'": meanings(TrainingOptions),
    "Evaluation of policy=..., by stages=evaluate": meanings(EvaluationOptions, "evaluation."),
    "Data from elsewhere, by stages=certify": meanings(CertifyOptions, "certify."),
    "Publishing, by stages=publish": meanings(PublishOptions, "publish."),
    "Export, by stages=export": meanings(ExportOptions, "export."),
    "Seasons, by stages=season, judge, reveal and verify": meanings(SeasonOptions, "season."),
}
"""What each option means, in the order of `--help`, under its headings."""

OPTIONS = {name: meaning for section in SECTIONS.values() for name, meaning in section.items()}
"""What each option means, as `--help` and docs/options.md say it."""

DEFAULTS = {name: default_of(each) for name, each, _ in declared(RunConfig)}
"""The default of each option as it is typed; empty for an option without one."""

KINDS = {name: kind for name, _, kind in declared(RunConfig)}
"""The declared type of each option."""


@dataclass(frozen=True)
class Run:
    """One run of the program: its options, and the objects made from them."""

    options: RunConfig
    """All options; those that the requested stages use have been checked."""
    dataset: DatasetConfig
    data_dir: AnyPath
    names_dataset: bool = False
    """Whether the command line gives `size` or `task`; see `machinery.dataset.check_there`."""

    @property
    def part(self) -> tuple[int, int] | None:
        """The part that this process builds and the number of parts, such as (3, 64), if given."""
        part, _, parts = self.options.part.partition("/")
        return (int(part), int(parts)) if part else None

    @property
    def folder(self) -> AnyPath:
        """The folder of the run's dataset."""
        return self.data_dir / self.dataset.name

    @property
    def source(self) -> str:
        """The dataset to learn from: a folder, or an id on the Hub."""
        own = str(folder_at(self.options.data_dir))
        return own if self.options.dataset is None else self.options.dataset

    @property
    def dataset_on_hub(self) -> tuple[str, str | None]:
        """The Hub id and the revision of the dataset behind a published policy or environment."""
        publish = self.options.publish
        if publish.repo_id:
            return publish.repo_id, publish.version
        return str(self.options.dataset), self.options.revision

    @property
    def run_name(self) -> RunName:
        """The name that distinguishes the training run from others on the same dataset."""
        options = self.options
        return RunName(
            method=options.method_title,
            encoder=options.network,
            protocol=options.protocol,
            train_labyrinths=options.train_labyrinths,
            seed=options.seed,
        )

    @property
    def training_folder(self) -> Path:
        """The folder of the trained policy."""
        return Path(self.options.run_dir).expanduser() / self.dataset.name / self.run_name.name

    @property
    def export_folder(self) -> Path:
        """The folder of the dataset's exports, with a subfolder for each split."""
        asked = self.options.export
        return Path(asked.folder).expanduser() / asked.format / NAMESPACE / self.dataset.name

    @property
    def local_dir(self) -> Path:
        """The data_dir as a local folder; raises a ConfigError if it is in an object store."""
        if isinstance(self.data_dir, RemotePath):
            raise ConfigError(f"data_dir={self.data_dir}: report and publish need a local folder")
        return self.data_dir


def options_of(config: DictConfig) -> RunConfig:
    """Return the options that Hydra composed.

    Raises:
        ConfigError: An option that does not exist was added as `+name=value`.
        OmegaConfBaseException: A value has the wrong type, or refers to a missing value.
    """
    values: Any = OmegaConf.to_container(config, resolve=True)
    return frozen(RunConfig, values)


def resolve(options: RunConfig) -> Run:
    """Check the options and return the run that they describe.

    Raises:
        ConfigError: A value is invalid; the message says what was given and what is allowed.
    """
    check_options(options, PlaceOptions)
    check(
        options.executor_address is None or options.executor != "local",
        f"executor_address={options.executor_address}: executor=local has no address",
    )
    try:
        data_dir = folder_at(options.data_dir)
    except ValueError as error:
        raise ConfigError(f"data_dir={error}") from error
    check(
        not isinstance(data_dir, Path) or not (data_dir / MANIFEST).is_file(),
        f"data_dir={options.data_dir} is the folder of one dataset: give the folder that holds it",
    )
    if isinstance(data_dir, Path) and options.executor != "local":
        data_dir = data_dir.absolute()  # A cluster's workers may have another working directory.
    run = Run(options, dataset_config(options), data_dir)
    if run.part is not None:
        part, parts = run.part
        check(
            part <= parts, f"part={options.part}: give a part from 1 to {parts}, such as 1/{parts}"
        )
        check("build" in options.stages, f"part={options.part}: only stages=build runs in parts")
        # The other stages need the whole dataset, which the last run, without part, assembles.
        run = replace(run, options=replace(options, stages=("build",)))
        options = run.options
    check_method(options)
    stages = set(options.stages)
    if stages & {"report", "publish"}:
        _ = run.local_dir  # Raises a ConfigError if the folder is in an object store.
    if options.policy and stages & {"train", "evaluate"}:
        check("train" not in stages, f"policy={options.policy}: give stages=evaluate, not train")
        check_policy(options, options.evaluation)
    elif stages & {"train", "evaluate", "results"} or options.publish.model:
        check_training(options)
        if "evaluate" in stages:
            check_unnamed(options.evaluation)
    if "publish" in stages:
        check_publish(options.publish, options.export, options)
    if "certify" in stages:
        check_certify(options.certify)
    if "export" in stages:
        check_options(options.export, ExportOptions, "export.")
    if stages & {*SEASON_STAGES}:
        check_season(options.season, stages, options.seed, options.executor)
    return run
