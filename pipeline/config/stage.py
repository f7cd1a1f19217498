"""What a stage is, and what it is given.

A wing of the program is a folder with `options.py`, which declares its stages, and their modules.
`pipeline.command.stages` names the wings; no other module does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from labyrinth_core.data import DatasetConfig, Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import AnyPath, File
from pipeline.config.declaration import ConfigError, as_typed, check

if TYPE_CHECKING:
    from labyrinth_core.data import Dataset

Options = TypeVar("Options", covariant=True)


@dataclass(frozen=True)
class Job(Generic[Options]):
    """What a stage is given: its own options, and the dataset that the command line describes."""

    options: Options
    dataset: DatasetConfig
    data_dir: AnyPath
    """The folder of datasets; absolute if a cluster's workers use it."""
    typed_dir: str
    """`data_dir` as results and records name it: as typed, so that a home folder stays `~`."""
    names_dataset: bool = False
    """Whether the command line gives `size` or `task`, so that the dataset has to exist."""
    composed: Callable[[], str] = str
    """Returns all options of the command line, as the content of `CONFIG`; empty without one."""
    CONFIG: ClassVar[str] = "config.yaml"
    """The file beside what a stage made, with the options that it was made with."""

    @property
    def folder(self) -> AnyPath:
        """The folder of the dataset."""
        return self.data_dir / self.dataset.name

    @property
    def source(self) -> str:
        """The dataset that the stage reads, as results name it: a folder, or an id on the Hub."""
        named = getattr(self.options, "dataset", None)
        return self.typed_dir if named is None else str(named)

    @property
    def local_dir(self) -> Path:
        """The data_dir as a local folder; raises a ConfigError if it is in an object store."""
        if not isinstance(self.data_dir, Path):
            raise ConfigError(f"data_dir={self.data_dir}: report and publish need a local folder")
        return self.data_dir

    def require_dataset(self) -> None:
        """Raise a DatasetError if the dataset does not exist; the message says how to make it."""
        if not (self.folder / Manifest.FILE).is_file():
            size = f"size={self.dataset.height}x{self.dataset.width} task={self.dataset.task}"
            command = f"labyrinth-datasets {size} {as_typed('data_dir', str(self.data_dir))}"
            raise DatasetError(f"{self.folder} holds no dataset: {command} makes it")

    def open_dataset(self, train_labyrinths: int | None = None) -> Dataset:
        """Return the dataset that the stage reads, of `SourceOptions`.

        Args:
            train_labyrinths: The number of labyrinths to learn from, which train must have.

        Raises:
            ConfigError: A folder is given with a revision, or train has too few labyrinths.
            DatasetError: The dataset does not exist.
        """
        from labyrinth_core.data import Dataset

        options: Any = self.options
        if options.dataset is None:
            self.require_dataset()
        try:
            data = Dataset(self.source, self.dataset.name, options.revision)
        except ValueError as error:
            raise ConfigError(str(error)) from error
        if train_labyrinths is not None:
            most = sum(shard.labyrinths for shard in data.manifest.of("train"))
            check(
                train_labyrinths <= most,
                f"train_labyrinths={train_labyrinths}: give {most} or fewer, as many as train of "
                f"{self.source} has",
            )
        return data

    def write_config(self, folder: Path) -> None:
        """Write the options of the command line, if there is one, beside what they made."""
        if content := self.composed():
            File(folder / self.CONFIG).write_text(content)


@dataclass(frozen=True)
class Stage:
    """The declaration of a stage."""

    module: str
    """The module with `run(job)`, and perhaps `refuse(job)`, called before any stage runs."""
    options: type
    """The dataclass of the options that the stage is given; see `pipeline.config.declaration`."""
    check: Callable[[Job[Any], Sequence[str]], None] = lambda _job, _stages: None
    """Raises a ConfigError if an option is invalid, or does not fit the requested stages."""
    headings: Mapping[str, type] = field(default_factory=dict)
    """Heading in `--help` -> the class that declares the options below it."""
    next_step: Callable[[Job[Any], Sequence[str]], tuple[str, ...]] = lambda _job, _stages: ()
    """Returns what to suggest if the stage ran last, given all stages: the options of the next
    command and its purpose; or a line as it is; or nothing."""
    idle: Callable[[Any], Mapping[str, str]] = lambda _options: {}
    """Returns the options that the stage does not use beside the given ones, each with what it is
    used with, such as `with publish.model`."""
    runs_alone: Callable[[Any], bool] = lambda _options: False
    """Returns whether no later stage can run after one with these options."""
    is_default: bool = False
    """Whether the stage runs if the command line names no stages."""
