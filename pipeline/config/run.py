"""One run of the program: its options, the schema of all options, and the text of `--help`.

Hydra and OmegaConf stop here: `resolve` gives an object that the rest of the pipeline trusts.
"""

from __future__ import annotations

import difflib
import re
import textwrap
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.errors import MissingConfigException
from omegaconf import DictConfig, OmegaConf

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.storage import AnyPath, RemotePath
from pipeline.config.analysis import AnalysisOptions, LeakageOptions, check_analysis
from pipeline.config.dataset import DatasetOptions, dataset_config
from pipeline.config.errors import ConfigError, listed
from pipeline.config.option import check_options, frozen, meanings
from pipeline.config.place import PlaceOptions, place_of
from pipeline.config.publish import PublishOptions
from pipeline.config.training import TrainingOptions, check_training


@dataclass(frozen=True)
class RunConfig(TrainingOptions):
    """All options, as they are given on a command line."""

    leakage: LeakageOptions = field(default_factory=LeakageOptions)
    analysis: AnalysisOptions = field(default_factory=AnalysisOptions)
    publish: PublishOptions = field(default_factory=PublishOptions)


SECTIONS = {
    "What the dataset is": meanings(DatasetOptions),
    "Where and how it is made": meanings(PlaceOptions),
    "What is trained on it, by stages=[train,evaluate]": meanings(TrainingOptions),
    "What is analysed, by stages=[analyse] and stages=[environments]": {
        **meanings(LeakageOptions, "leakage."),
        **meanings(AnalysisOptions, "analysis."),
    },
    "Where it is published, by stages=[publish]": meanings(PublishOptions, "publish."),
}
"""What each option means, in the order of `--help`, under its headings."""

OPTIONS = {name: meaning for section in SECTIONS.values() for name, meaning in section.items()}
"""What each option means, as `--help` and the README say it."""


@dataclass(frozen=True)
class Run:
    """One run of the program: its options, and what was made of them."""

    options: RunConfig
    """Those of the stages that are asked for are checked."""
    dataset: DatasetConfig
    data_dir: AnyPath

    @property
    def folder(self) -> AnyPath:
        """Where the dataset of this run lies."""
        return self.data_dir / self.dataset.name

    @property
    def local_dir(self) -> Path:
        """The data_dir, for stages that need it on this machine; ConfigError if it is elsewhere."""
        if isinstance(self.data_dir, RemotePath):
            raise ConfigError(f"data_dir={self.data_dir}: report and publish need a local folder")
        return self.data_dir


_HELP = """Make a dataset of labyrinths: unique, solved optimally, pictured, in Parquet shards.
Train a policy on it.

    labyrinth-datasets size=5
    labyrinth-datasets size=5 stages=[train,evaluate] method=bc encoder=cnn seed=0
    labyrinth-datasets stages=[results]
    labyrinth-datasets size=4x6 task=key_and_door labyrinths=1000 workers=2
    labyrinth-datasets -m size=3,4,5

Options, each as name=value:

{options}
--cfg job prints the values that a command line gives, --hydra-help the flags of Hydra itself.
"""


def register() -> None:
    """Tell Hydra the schema and the text of `--help`."""
    store = ConfigStore.instance()
    store.store(name="schema", node=_writable(OmegaConf.structured(RunConfig)))
    help_text = _HELP.format(options="\n".join(map(_described, SECTIONS)))
    store.store(group="hydra/help", name="options", node={"template": help_text})


def _writable(node: DictConfig) -> DictConfig:
    """Return what OmegaConf made of a frozen dataclass, so that Hydra can merge values into it."""
    OmegaConf.set_readonly(node, None)
    for child in node.values():
        if isinstance(child, DictConfig):
            _writable(child)
    return node


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
        group, _, _ = unknown[1].rpartition(".")
        parent = getattr(error.__cause__, "parent_node", None) if group else None
        known = list(OPTIONS) if parent is None else [f"{group}.{name}" for name in parent]
        close = difflib.get_close_matches(unknown[1], known, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        return f"{unknown[1]} is no option: {hint}choose from {listed(known)}"
    field_name = re.search(r"full_key: (\S+)", text)
    message = " ".join(text.partition("full_key")[0].split())
    return f"{field_name[1]}: {message}" if field_name else message


def options_of(config: DictConfig) -> RunConfig:
    """Return the options that Hydra composed.

    Raises:
        ConfigError: There is an option that is none, added as `+name=value`.
        OmegaConfBaseException: A value is of another kind, or refers to what is not there.
    """
    values: Any = OmegaConf.to_container(config, resolve=True)
    return frozen(RunConfig, values)


def resolve(options: RunConfig) -> Run:
    """Return the run that options ask for.

    Raises:
        ConfigError: A value is impossible; the text says what was given and what is allowed.
    """
    run = Run(options, data_dir=place_of(options), dataset=dataset_config(options))
    stages = set(options.stages)
    if stages & {"report", "publish"}:
        _ = run.local_dir
    if stages & {"train", "evaluate", "results"}:
        check_training(options)
    if "environments" in stages:
        check_analysis(options.analysis)
    if "publish" in stages:
        check_options(options.publish, PublishOptions, "publish.")
    return run
