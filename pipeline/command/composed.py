"""The options of a command line, and the jobs that its stages are given.

Hydra and OmegaConf stop here: `resolve` returns objects that the rest of the pipeline trusts. The
method is a file of the group `method`, or a class of the user: `_target_` is the dotted name of a
class, as `hydra.utils.get_class` reads it. Records and tables call a method `bc` if it is one of
ours, and `mine:Method` if it is the class `mine.Method`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from copy import copy
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass, make_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast, get_type_hints

import yaml
from omegaconf import DictConfig, OmegaConf

from labyrinth_core.data import SPLITS, DatasetConfig, Manifest
from labyrinth_core.language import parse_size
from labyrinth_core.storage import folder_at
from labyrinth_core.world import ALGORITHMS, BUCKETS, Task, default_open_walls
from pipeline.command.stages import STAGES
from pipeline.config import (
    ConfigError,
    Job,
    ResultFolderOptions,
    TrainingOptions,
    WorkOptions,
    check,
    check_options,
    frozen,
    literal,
    option,
)

_INSTALLED = Path(__file__).parents[1] / "conf"
CONF = (_INSTALLED if _INSTALLED.is_dir() else Path(__file__).parents[2] / "conf").absolute()
"""Hydra's configuration folder: in the installed package, or else in the clone."""

Options = TypeVar("Options")


ALL_SHIFTS = "all"
"""The value of `shifts` that stands for every shift that the other options allow."""


@dataclass(frozen=True)
class SplitsConfig:
    """How far apart the splits are."""

    min_walls: int = option(
        1, "least number of walls in which structures of two splits differ (1: not equal)"
    )


@dataclass(frozen=True)
class DemonstrationsConfig:
    """How well the demonstrator acts."""

    noise: float = option(
        0.0, "probability that the demonstrator acts at random, and goes on from there"
    )


@dataclass(frozen=True)
class DatasetOptions:
    """The content of a dataset; `DatasetConfig` checks the values."""

    size: str = option("5", "rows and columns: 5, or height x width such as 4x6")
    task: str = option(
        "navigation",
        f"{', '.join([*Task][:-1])} or {[*Task][-1]}",
        one_of=map(str, Task),
    )
    labyrinths: int | None = option(
        None, "labyrinths in each of train, validation and test (32 at 3x3, else 100)"
    )
    solutions: str = option(
        "shortest", "routes per labyrinth: shortest (one), all_shortest, all (every simple route)"
    )
    solutions_limit: int = option(1000, "maximum routes per labyrinth, for all_shortest and all")
    random_steps: int = option(100, "random steps per labyrinth, in the split random")
    sampler: str = option(
        "wilson", "algorithm of the spanning tree in each structure: " + ", ".join(ALGORITHMS)
    )
    open_walls: float | None = option(
        None,
        "probability of opening each wall that the spanning tree leaves (0.12 at 3x3, 0.09 at "
        "4x4, else 0.08)",
    )
    buckets: tuple[int, ...] = option(
        BUCKETS,
        "percent of all structures that may be in train, in validation and in test; keep it the "
        "same in datasets to compare",
    )
    splits: SplitsConfig = SplitsConfig()
    shifts: tuple[str, ...] = option(
        (),
        "extra splits, each with one thing shifted: all, or a list of " + ", ".join(SPLITS.shifts),
        one_of=(ALL_SHIFTS, *SPLITS.shifts),
    )
    demonstrations: DemonstrationsConfig = DemonstrationsConfig()
    goals: str = option(
        "fixed",
        "where start and goal of train, validation and test lie: fixed (bottom left and top "
        "right) or varied (drawn for each labyrinth)",
    )
    seed: int = option(0, "random seed; the same options and seed give the same bytes or weights")


@dataclass(frozen=True)
class DataFolderOption:
    """Where datasets are."""

    data_dir: str = option(
        "data/labyrinth",
        "folder of datasets, or a URL such as s3://bucket/name; each size and task has a subfolder",
        like=(r"(?s).*\S.*", "a folder"),
    )


@dataclass(frozen=True)
class CommandOptions(WorkOptions, DataFolderOption):
    """What all stages share: where datasets are, and how work is done."""

    stages: tuple[str, ...] = option(
        tuple(name for name, stage in STAGES.items() if stage.is_default),
        "stages to run, in the order given: " + ", ".join(STAGES),
        one_of=STAGES,
    )


@dataclass(frozen=True)
class _Folders(CommandOptions, ResultFolderOptions):
    """The options below the second heading of `--help`."""


_HEADINGS: dict[str, type] = {
    "Dataset": DatasetOptions,
    "Where and how": _Folders,
    "Training, by 'stages=[train,evaluate]'": TrainingOptions,
}
"""The headings of `--help`, and the class that declares the options below each."""

for _stage in STAGES.values():
    _HEADINGS |= _stage.headings


def declared(cls: type, group: str = "") -> Iterator[tuple[str, Field[Any], Any]]:
    """Yield the name, the field and the type of each option that a class and its groups declare.

    Args:
        cls: The class.
        group: The prefix of the names, such as `publish.`.
    """
    kinds = get_type_hints(cls)
    for each in fields(cls):
        name, kind = group + each.name, kinds[each.name]
        if is_dataclass(kind):
            yield from declared(cast(type, kind), f"{name}.")
        else:
            yield name, each, kind


def default_of(each: Field[Any]) -> str:
    """Return the default of an option as a user would type it; empty if it has none."""
    default = each.default
    if each.default_factory is not MISSING:
        default = each.default_factory()["name"]
    if isinstance(default, tuple):
        every = bool(default) and [*default] == each.metadata["checks"].one_of
        if default and not isinstance(default[0], str):
            return f"[{','.join(map(str, default))}]"
        return "all" if every else ",".join(default)
    if default is None:
        return ""
    return str(default).lower() if isinstance(default, bool) else str(default)


def _merged(classes: Iterable[type]) -> type:
    """Return a dataclass with the options of several."""
    made: dict[str, tuple[str, Any, Any]] = {}
    for cls in classes:
        kinds = get_type_hints(cls)
        made |= {each.name: (each.name, kinds[each.name], copy(each)) for each in fields(cls)}
    return make_dataclass("AllOptions", made.values(), frozen=True)


ALL = _merged([DatasetOptions, CommandOptions, *(stage.options for stage in STAGES.values())])
"""All options, as they are given on a command line."""

_LISTED: set[str] = set()

SECTIONS = {
    heading: {
        name: each.metadata["meaning"]
        for name, each, _ in declared(cls)
        if not (name in _LISTED or _LISTED.add(name))  # type: ignore[func-returns-value]
    }
    for heading, cls in _HEADINGS.items()
}
"""What each option means, in the order of `--help`, under its headings."""

OPTIONS = {name: meaning for section in SECTIONS.values() for name, meaning in section.items()}
"""What each option means, as `--help` and docs/options.md say it."""

DEFAULTS = {name: default_of(each) for name, each, _ in declared(ALL)}
"""The default of each option as it is typed; empty for an option without one."""

KINDS = {name: kind for name, _, kind in declared(ALL)}
"""The declared type of each option."""

GROUPS = {name.partition(".")[0] for name in KINDS}
"""The options, and the groups of options; other names of a command line are Hydra's."""

SHARED = {each.name for cls in (DatasetOptions, CommandOptions) for each in fields(cls)} - {
    "stages"
}
"""The options that any stage may use."""


def part_of(options: Any, cls: type[Options]) -> Options:
    """Return the options that a class declares, from an object with at least these."""
    return cls(**{each.name: getattr(options, each.name) for each in fields(cls)})  # type: ignore[arg-type]


def unused(names: Iterable[str], options: Any) -> dict[str, tuple[str, ...]]:
    """Return the options that no requested stage uses, each with the stages that do.

    Args:
        names: The names of the options that a command line gives.
        options: An instance of `ALL`.
    """
    known = [stage for stage in options.stages if stage in STAGES]
    idle = {stage: STAGES[stage].idle(options) for stage in known}
    lost = {}
    for name in names:
        first = name.partition(".")[0]
        users = [
            stage
            for stage, declaration in STAGES.items()
            if first not in SHARED
            and any(each.name == first for each in fields(declaration.options))
        ]
        if users and all(first in idle.get(stage, {first: ""}) for stage in users):
            lost[name] = tuple(
                f"{stage} {idle[stage][first]}" if stage in idle else stage for stage in users
            )
    return lost


def names_in(overrides: Iterable[str]) -> list[str]:
    """Return the names of the options in overrides such as `+publish.version=1.0.0`."""
    return [each.lstrip("+~").partition("=")[0] for each in overrides]


@cache
def usual_settings(name: str) -> Mapping[str, Any]:
    """Return the settings of a method in its file of the group `method`, with their values."""
    text = (CONF / "method" / f"{name}.yaml").read_text(encoding="utf-8")
    return {key: value for key, value in yaml.safe_load(text).items() if key != "_target_"}


def chosen_method(values: Mapping[str, Any], typed: Container[str]) -> dict[str, Any]:
    """Return the name of a method in records, and the settings that were chosen for it.

    A setting is chosen if the command line gives it, or has another value than in the method's own
    file; those of a user's method all are. The others are not compared with a run's when the run is
    evaluated.

    Args:
        values: `_target_` and the settings, as composed.
        typed: The names of the options that the command line gives, such as `method.epochs`.

    Raises:
        ConfigError: The class is missing or is not a dotted name, or a setting does not exist.
    """
    settings = {key: value for key, value in values.items() if key != "_target_"}
    target = str(values.get("_target_", ""))
    check(
        re.fullmatch(r"\w+(\.\w+)+", target) is not None,
        f"method._target_={target}: give the class of a method as module.Class",
    )
    name = TrainingOptions.name_of(target)
    if name in TrainingOptions.METHODS:
        usual = usual_settings(name)
        for key in settings:
            known = [f"method.{each}" for each in usual]
            if key not in usual:
                raise ConfigError.no_option(f"method.{key}", known)
        settings = {
            key: value
            for key, value in settings.items()
            if value != usual[key] or f"method.{key}" in typed
        }
    return {"name": name, **settings}


def options_of(config: DictConfig, overrides: Iterable[str] = ()) -> Any:
    """Return the options that Hydra composed, an instance of `ALL`.

    Args:
        config: The configuration.
        overrides: The overrides of the command line.

    Raises:
        ConfigError: An option that does not exist was added as `+name=value`, or is a setting that
            the method does not have.
        OmegaConfBaseException: A value has the wrong type, or refers to a missing value.
    """
    values: Any = OmegaConf.to_container(config, resolve=True)
    method = values.get("method")
    check(isinstance(method, dict), f"method={method}: give one name, such as method=bc")
    return frozen(ALL, values | {"method": chosen_method(method, names_in(overrides))})


def as_file(config: DictConfig) -> str:
    """Return the content of a file from which Hydra composes the same options again."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(each) for key, each in value.items()}
        if isinstance(value, list):
            return [plain(each) for each in value]
        return literal(value) if isinstance(value, str) else value

    values: Any = plain(OmegaConf.to_container(config, resolve=True))
    again = (
        "# To use these options again: labyrinth-datasets --config-dir FOLDER --config-name config"
    )
    return f"{again}\ndefaults: [base, _self_]\n{OmegaConf.to_yaml(OmegaConf.create(values))}"


def resolve(
    options: Any, *, names_dataset: bool = False, composed: Callable[[], str] = str
) -> Mapping[str, Job[Any]]:
    """Check the options of a command line, and return the job of each stage that it requests.

    Args:
        options: An instance of `ALL`.
        names_dataset: As for `Job`.
        composed: As for `Job`.

    Raises:
        ConfigError: A value is invalid; the message says what was given and what is allowed.
    """
    check_options(options, CommandOptions)
    try:
        data_dir = folder_at(options.data_dir)
    except ValueError as error:
        raise ConfigError(f"data_dir={error}") from error
    check(
        not isinstance(data_dir, Path) or not (data_dir / Manifest.FILE).is_file(),
        f"data_dir={options.data_dir} is the folder of one dataset: give the folder that holds it",
    )
    typed_dir = Path(options.data_dir) if options.data_dir.startswith("~") else data_dir
    if options.executor != "local":
        data_dir = data_dir.absolute()  # A cluster's workers may have another working directory.
    dataset = dataset_config(options)
    jobs = {}
    for name in options.stages:
        own: Any = part_of(options, STAGES[name].options)
        check_options(own, STAGES[name].options)
        jobs[name] = Job(own, dataset, data_dir, str(typed_dir), names_dataset, composed)
        STAGES[name].check(jobs[name], options.stages)
    alone = {name: job for name, job in jobs.items() if STAGES[name].runs_alone(job.options)}
    return alone or jobs


def dataset_config(options: DatasetOptions) -> DatasetConfig:
    """Return the configuration that determines the rows of the dataset.

    Each option, also of `splits` and `demonstrations`, becomes the field of the same name; `size`
    becomes `height` and `width`.

    Raises:
        ConfigError: A value is invalid.
    """
    check_options(options, DatasetOptions)
    try:
        values = {each.name: getattr(options, each.name) for each in fields(DatasetOptions)}
        height, width = parse_size(values.pop("size"))
        values |= vars(values.pop("splits")) | vars(values.pop("demonstrations"))
        values["task"] = Task(options.task)
        if options.labyrinths is None:
            values["labyrinths"] = 32 if (height, width) == (3, 3) else 100
        if options.open_walls is None:
            values["open_walls"] = default_open_walls(height, width)
        for name in ("open_walls", "noise"):  # Hydra passes 1 as an int.
            values[name] = float(values[name])
        config = DatasetConfig(height=height, width=width, **values | {"shifts": ()})
        return replace(config, shifts=_shifts(config, options.shifts))
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _shifts(config: DatasetConfig, named: tuple[str, ...]) -> tuple[str, ...]:
    """Return the requested shifts in the order of `SPLITS.shifts`; `all` gives every possible one.

    Raises:
        ValueError: `all` is combined with others.
    """
    if named == (ALL_SHIFTS,):
        return tuple(name for name in SPLITS.shifts if config.why_no(name) is None)
    if ALL_SHIFTS in named:
        raise ValueError(
            f"shifts=[{', '.join(named)}]: give all alone, or some of [{', '.join(SPLITS.shifts)}]"
        )
    return tuple(name for name in SPLITS.shifts if name in named)
