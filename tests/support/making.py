"""How the tests make runs and small datasets, and what a command line asks for."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, fields, make_dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, get_type_hints

from hydra import compose, initialize_config_dir

from labyrinth_core.data import Drawing
from labyrinth_core.evaluation import RunName
from pipeline.command import command_line
from pipeline.command import composed as declared
from pipeline.command.stages import STAGES
from pipeline.config import Job
from pipeline.generation import build

SplitsConfig, DemonstrationsConfig = declared.SplitsConfig, declared.DemonstrationsConfig


@dataclass(frozen=True)
class Run(Job[Any]):
    """A job with all options, which any stage takes."""

    @property
    def run_name(self) -> RunName:
        return self.options.run_name(self.dataset)

    @property
    def training_folder(self) -> Path:
        return self.options.run_folder(self.dataset)


def _derived(options: Any, name: str) -> Any:
    """Return what a stage's class of options has beside the options."""
    for stage in STAGES.values():
        if hasattr(stage.options, name):
            return getattr(declared.part_of(options, stage.options), name)
    raise AttributeError(name)


_KINDS = get_type_hints(declared.ALL)

RunConfig = make_dataclass(
    "RunConfig",
    [(each.name, _KINDS[each.name], copy(each)) for each in fields(declared.ALL)],
    frozen=True,
    namespace={"__getattr__": _derived},
)
"""All options of a command line, with what the options of single stages compute from them."""


def resolve(options: Any) -> Run:
    """Check options as a command line's are, and return a job with all of them."""
    jobs = declared.resolve(options)
    first = next(iter(jobs.values()))
    return Run(**vars(first) | {"options": replace(options, stages=tuple(jobs))})


def run_of(data_dir: Path, **options: Any) -> Run:
    """Return the job with the options of `RunConfig`; a small one where they say nothing."""
    small = {"stages": ["build"], "size": "3", "labyrinths": 8, "data_dir": str(data_dir)}
    return resolve(RunConfig(**small | options))


def perform(stage: str, run: Run) -> None:
    """Run a stage of a job in this process, as a command line does."""
    import_module(STAGES[stage].module).run(run)


def build_dataset(
    data_dir: Path,
    *,
    cells_per_shard: int = build.CELLS_PER_SHARD,
    cells_per_chunk: tuple[int, int] = Drawing.CELLS_PER_CHUNK,
    **options: Any,
) -> Run:
    """Build the dataset of `run_of`, and return the run."""
    run = run_of(data_dir, **options)
    build.run(run, cells_per_shard=cells_per_shard, cells_per_chunk=cells_per_chunk)
    return run


def make(data_dir: Path, size: str, task: str = "navigation", **options: Any) -> Path:
    """Build a dataset and return its folder."""
    return build_dataset(data_dir, size=size, task=task, **options).folder


def make_both(data_dir: Path) -> Path:
    """Build two datasets, and return the folder of both."""
    make(data_dir, "3x3", labyrinths=7, random_steps=25)
    make(data_dir, "3x4", "key_and_door", labyrinths=3, random_steps=25, solutions="all")
    return data_dir


def composed(*arguments: str) -> Run:
    """Return the run that a command line asks for."""
    command_line.register()
    given = command_line.parsed(arguments).overrides
    with initialize_config_dir(str(declared.CONF), **command_line.HYDRA):
        options = declared.options_of(command_line.as_given(compose("config", given), given), given)
    return resolve(RunConfig(**vars(options)))
