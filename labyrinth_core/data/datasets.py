"""`Dataset`: a dataset as an object, and `Selection`, a split of it or some labyrinths of a split.

    from labyrinth_core import Dataset

    data = Dataset("data/labyrinth", "5x5")
    transitions = data["train"].transitions(image_size=64)

The functions of `load` and `stream` give the same in one call. These modules are imported when
rows are read, because a build needs only the manifest and the table.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.data.dataset import Filter, Query, Source, folder_of
from labyrinth_core.data.dataset_config import SPLITS, is_of_train
from labyrinth_core.data.manifest import Manifest, Shard
from labyrinth_core.data.table import Step, unlike_shards
from labyrinth_core.errors import printable_line
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE
from labyrinth_core.storage import AnyPath
from labyrinth_core.world import Labyrinth

if TYPE_CHECKING:
    import pyarrow as pa
    from gymnasium.spaces import Discrete, Space

    from labyrinth_core.data.load import Episodes, LoadedEpisode
    from labyrinth_core.data.stream import Stream
    from labyrinth_core.data.transitions import Transition, Transitions
    from labyrinth_core.env import LabyrinthEnv


class Dataset(Source):
    """A dataset in a folder or on the Hub; `data["train"]` is its split train.

    The manifest is read at once, everything else when it is asked for. All of it belongs to this
    manifest, and on the Hub to one commit: if the dataset in a folder is built anew meanwhile,
    reading raises DatasetError.

    Args:
        source: Folder with the dataset, its URL such as `s3://bucket/labyrinth`, or its id on the
            Hub such as `user/labyrinth`.
        config: Name of the dataset's config, such as `5x5` or `5x5-key_and_door`.
        revision: Branch, tag or commit on the Hub; not for folders.

    Raises:
        ValueError: An argument has a value that is not allowed.
        DatasetError: The dataset does not exist, or its manifest cannot be read.
    """

    def __init__(self, source: str | Path, config: str, revision: str | None = None) -> None:
        super().__init__(source, config, revision)
        _ = self.manifest  # It is read now.

    @classmethod
    def of(cls, source: str | Path | Dataset, config: str | None, revision: str | None) -> Dataset:
        """Return the dataset that a function is given, as such or as source and config.

        Raises:
            ValueError: A dataset is given with a config or a revision, or a source without config.
            DatasetError: As for the class.
        """
        if not isinstance(source, Dataset):
            return cls(source, config, revision)  # type: ignore[arg-type]  # It refuses None.
        for name, value in (("config", config), ("revision", revision)):
            if value is not None:
                raise ValueError(f"{name}={value!r:.60}: leave it out, the Dataset has its own")
        return source

    @classmethod
    def at(
        cls,
        folder: AnyPath,
        manifest: Manifest | None = None,
        *,
        renamed: bool = False,
        companion: str = "",
    ) -> Dataset:
        """Return the dataset in a folder, such as `data/labyrinth/5x5`.

        Args:
            folder: The folder.
            manifest: The manifest of the folder, if it has been read.
            renamed: As for `Manifest.read`.
            companion: As for `Manifest.read`.

        Raises:
            DatasetError: The manifest is missing or malformed, or of a dataset of another name.
        """
        data = cls.__new__(cls)
        Source.__init__(data, str(folder.parent), folder.name)
        data.local = folder
        data.manifest = manifest or Manifest.read(folder, renamed=renamed, companion=companion)
        return data

    @staticmethod
    def is_folder(source: str | Path) -> bool:
        """Return whether a source is a folder, here or in a store; else it is an id on the Hub.

        Raises:
            DatasetError: It is neither.
        """
        return folder_of(source) is not None

    @property
    def folder(self) -> AnyPath:
        """The folder of the dataset; for one on the Hub, that of its downloaded files."""
        return self.locate([])

    @property
    def splits(self) -> tuple[str, ...]:
        """The names of the splits."""
        return tuple(dict.fromkeys(shard.split for shard in self.manifest.shards))

    @property
    def fingerprint(self) -> str:
        """The hash of all rows of all splits; the same configuration gives the same one."""
        return self.manifest.fingerprint

    @cached_property
    def table(self) -> pa.Table:
        """The table of labyrinths, one row per labyrinth and split.

        Its columns are `labyrinth_core.data.format.TABLE_COLUMNS`.
        """
        import pyarrow as pa

        return pa.concat_tables(self.table_groups())

    def __getitem__(self, split: str) -> Selection:
        """Return a split; raise DatasetError if the dataset has none of this name."""
        self.manifest.of(split)
        return Selection(self, split)

    def of_first(self, split: str, count: int | None) -> Selection:
        """Return a split without the labyrinths that come from others than the first of train.

        Splits that are not derived from train are returned whole.

        Args:
            split: The name of the split.
            count: The number of labyrinths of train; None for all.

        Raises:
            ValueError, DatasetError: As for `Selection.filter`.
        """
        if count is None or not is_of_train(split):
            return self[split]
        if split in SPLITS.base:  # One labyrinth for each of train.
            return self[split].filter(labyrinths=count)
        from pyarrow.compute import field

        count = len(self["train"].filter(labyrinths=count).spans[0])  # It raises the errors.
        parents = self.table.filter(field("split") == "train")["labyrinth_id"].slice(0, count)
        return self[split].filter(field("parent_id").isin(parents.to_pylist()))

    def __iter__(self) -> Iterator[str]:
        """Yield the names of the splits."""
        return iter(self.splits)

    def __repr__(self) -> str:
        """Return what the dataset is, in five lines."""
        shards, about = self.manifest.shards, self.manifest.config
        counts = (f"{split} {self[split].total_labyrinths:,}" for split in self.splits)
        episodes = sum(shard.episodes for shard in shards)
        steps = sum(shard.rows for shard in shards) - episodes
        return (
            f"Dataset {_named(self)}\n"
            f"  labyrinths: {about.height} x {about.width}, {about.task}\n"
            f"  splits: {', '.join(counts)}\n"
            f"  episodes: {episodes:,} of {steps:,} steps\n"
            f"  fingerprint: {self.fingerprint}"
        )


class Selection(Query):
    """A split of a dataset, or some labyrinths of it, as `Dataset` and `filter` return it."""

    dataset: Dataset

    @property
    def total_labyrinths(self) -> int:
        """The number of labyrinths."""
        if self.steps:
            return len(self.spans[0])
        return sum(shard.labyrinths for shard in self._shards)

    @property
    def total_episodes(self) -> int:
        """The number of episodes."""
        if not self.steps:
            return sum(shard.episodes for shard in self._shards)
        return int(self._episodes.sum())

    @property
    def total_steps(self) -> int:
        """The number of transitions."""
        rows = self.spans[1].sum() if self.steps else sum(shard.rows for shard in self._shards)
        return int(rows) - self.total_episodes  # The last row of an episode has no action.

    @property
    def observation_space(self) -> Space[Any]:
        """Gymnasium's space of the observations of `transitions()`, pictures of 64 x 64."""
        from labyrinth_core.env import LabyrinthEnv

        about = self.dataset.manifest.config
        return LabyrinthEnv((about.height, about.width), about.task).observation_space

    @property
    def action_space(self) -> Discrete:
        """Gymnasium's space of the actions: 0 up, 1 right, 2 down, 3 left."""
        from gymnasium.spaces import Discrete

        return Discrete(4)

    @cached_property
    def labyrinths(self) -> tuple[Labyrinth, ...]:
        """The labyrinths, in the order of the dataset."""
        held: dict[int, Labyrinth] = {}
        for block in self.replayed():
            for number, labyrinth in zip(block.ids.tolist(), block.parsed(), strict=True):
                held.setdefault(number, labyrinth)
        return tuple(held.values())

    def filter(self, where: Filter | None = None, *, labyrinths: int | None = None) -> Self:
        """Return some of these labyrinths.

        Args:
            where: A filter of the table of labyrinths, such as
                `pyarrow.compute.field("moves") >= 12`; None for all.
            labyrinths: The number of labyrinths: the first that match; None for all.

        Raises:
            ValueError: There are fewer labyrinths, or the filter cannot be applied.
            DatasetError: The table of labyrinths cannot be read.
        """
        some = super().filter(where, labyrinths=labyrinths)
        if some is not self:
            _ = some.spans  # It raises the errors now.
        return some

    def transitions(
        self,
        *,
        observation: str = "image",
        image_size: int = DEFAULT_IMAGE_SIZE,
        draw: bool = False,
        resize: str = "area",
        cache_dir: str | Path | bool | None = True,
        optimal: bool = False,
    ) -> Transitions:
        """Return all transitions; see `load_transitions`."""
        from labyrinth_core.data.load import transitions_in
        from labyrinth_core.pictures import ObservationSpec

        spec = ObservationSpec(observation, image_size, draw, resize)
        return transitions_in(self, spec, cache_dir, optimal=optimal)

    def iterate_episodes(
        self,
        *,
        observation: str = "image",
        image_size: int = DEFAULT_IMAGE_SIZE,
        draw: bool = False,
        resize: str = "area",
    ) -> Generator[LoadedEpisode]:
        """Yield the episodes in order; see `load_episodes`."""
        from labyrinth_core.data.load import episodes_in
        from labyrinth_core.pictures import ObservationSpec

        return episodes_in(self, ObservationSpec(observation, image_size, draw, resize))

    def sample_episodes(  # noqa: D417
        self,
        n: int,
        *,
        seed: int = 0,
        observation: str = "image",
        image_size: int = DEFAULT_IMAGE_SIZE,
        draw: bool = False,
        resize: str = "area",
    ) -> list[LoadedEpisode]:
        """Return random episodes, each at most once, in random order.

        Only their labyrinths are read.

        Args:
            n: The number of episodes.
            seed: Seed of the choice. See `load_episodes` for the other arguments.

        Raises:
            ValueError: An argument has a value that is not allowed.
            DatasetError: As for `load_episodes`.
        """
        from labyrinth_core.data.load import episodes_in
        from labyrinth_core.pictures import ObservationSpec

        spec = ObservationSpec(observation, image_size, draw, resize)
        counts = self._episodes
        ends = np.cumsum(counts)
        allowed = f"a whole number from 1 to {ends[-1]}, as many as there are"
        n = whole("n", n, 1, int(ends[-1]), allowed=allowed)
        rng = np.random.default_rng(whole("seed", seed, 0))
        drawn = rng.choice(ends[-1], n, replace=False)
        labyrinth = np.searchsorted(ends, drawn, "right")
        used, which = np.unique(labyrinth, return_inverse=True)
        # The numbers of the drawn episodes among all episodes of their labyrinths.
        skipped = (ends - counts)[used] - (np.cumsum(counts[used]) - counts[used])
        numbers = (drawn - skipped[which]).tolist()
        some = Selection(self.dataset, self.split, (*self.steps, Step(None, used)))
        read = enumerate(episodes_in(some, spec))
        needed = {*numbers}
        episodes = {number: episode for number, episode in read if number in needed}
        if len(episodes) < n:
            raise unlike_shards(self.split)
        return [episodes[number] for number in numbers]

    def stream(
        self,
        *,
        observation: str = "image",
        image_size: int = DEFAULT_IMAGE_SIZE,
        draw: bool = False,
        resize: str = "area",
        shuffle: bool | int = False,
        seed: int = 0,
        rank: int | None = None,
        world_size: int | None = None,
    ) -> Stream[Transition]:
        """Return a stream of the transitions; see `stream_transitions`."""
        from labyrinth_core.data.stream import Order, transition_stream
        from labyrinth_core.pictures import ObservationSpec

        order = Order.of(shuffle, seed, rank, world_size)
        spec = ObservationSpec(observation, image_size, draw, resize)
        return transition_stream(self, spec, order)

    def stream_episodes(
        self,
        *,
        observation: str = "image",
        image_size: int = DEFAULT_IMAGE_SIZE,
        draw: bool = False,
        resize: str = "area",
        shuffle: bool | int = False,
        seed: int = 0,
        rank: int | None = None,
        world_size: int | None = None,
    ) -> Stream[LoadedEpisode]:
        """Return a stream of the episodes; see `labyrinth_core.stream_episodes`."""
        from labyrinth_core.data.stream import Order, episode_stream
        from labyrinth_core.pictures import ObservationSpec

        order = Order.of(shuffle, seed, rank, world_size)
        spec = ObservationSpec(observation, image_size, draw, resize)
        return episode_stream(self, spec, order)

    def recover_environment(self, **options: Any) -> LabyrinthEnv:
        """Return an environment whose episodes take place in these labyrinths, one after the other.

        The first episode is in the first labyrinth, or after `reset(seed=s)` in number s, counted
        from 0 and modulo their number.

        Args:
            **options: Arguments of `LabyrinthEnv`, such as `render_mode="rgb_array"`.

        Raises:
            ValueError: An argument has a value that is not allowed.
            DatasetError: As for `load_episodes`.
        """
        from labyrinth_core.env import LabyrinthEnv

        return LabyrinthEnv(labyrinths=self.labyrinths, **options)

    def replayed(self) -> Generator[Episodes]:
        """Yield the episodes without their pictures, replayed many at a time."""
        from labyrinth_core.data.load import replayed

        part = self.part()
        return replayed(part.rows(pictures=False), part.config)

    def __len__(self) -> int:
        """Raise TypeError: episodes and steps could be meant."""
        raise TypeError("a split has no length: use total_episodes or total_steps")

    def __bool__(self) -> bool:
        """Return True, without asking for the length."""
        return True

    def __repr__(self) -> str:
        """Return what the selection is, in five lines."""
        count = f"{self.total_labyrinths:,}"
        if self.steps:
            count += f" of {self.dataset[self.split].total_labyrinths:,}"
        filters: list[str] = []
        for step in self.steps:
            filters += [str(step.where)] * (step.where is not None)
            filters += [f"the first {step.keep}"] * (step.keep is not None)
        return (
            f"Selection {self.split} in {_named(self.dataset)}\n"
            f"  labyrinths: {count}\n"
            f"  filter: {printable_line(', then '.join(filters)) or 'none'}\n"
            f"  episodes: {self.total_episodes:,}\n"
            f"  steps: {self.total_steps:,}"
        )

    @property
    def _shards(self) -> list[Shard]:
        return self.dataset.manifest.of(self.split)

    @cached_property
    def _episodes(self) -> NDArray[np.int64]:
        """The number of episodes of each labyrinth."""
        (counts,) = self.dataset.labyrinth_table.chosen(self.split, self.steps, ["episodes"])
        if ((counts < 1) | (counts > self.spans[1])).any():
            raise unlike_shards(self.split)
        return counts


def _named(dataset: Dataset) -> str:
    at = "" if dataset.revision is None else f"@{dataset.revision}"
    return printable_line(f"{dataset.config} of {dataset.source}{at}")
