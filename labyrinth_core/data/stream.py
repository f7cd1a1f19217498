"""Streams of episodes and transitions: shuffled, divided among processes, and resumed anywhere.

    from labyrinth_core import stream_transitions

    for s, a, s_next in stream_transitions("data/labyrinth", "5x5", shuffle=True):
        ...

`datasets` divides a stream by row group, too, but reads the footer of the file anew for each (ten
times the bytes at 5x5), loses its shuffle buffer when it resumes, and cuts long episodes in two.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.dataset import Filter, Part, Wanted, find_part
from labyrinth_core.data.episodes import LoadedEpisode
from labyrinth_core.data.load import Transition, episodes_of
from labyrinth_core.data.observations import ObservationSpec
from labyrinth_core.data.rows import TOGETHER
from labyrinth_core.pictures.png import DEFAULT_IMAGE_SIZE
from labyrinth_core.world.labyrinth import whole

if TYPE_CHECKING:
    from pyarrow.parquet import ParquetFile

BUFFER = 4096
"""The rows that `shuffle=True` holds; at 64 x 64 their pictures have 50 MB."""

TOGETHER_BYTES = 8 << 20
"""The bytes of unpacked row groups with pictures that are read in one go."""

Item = TypeVar("Item", covariant=True)


@dataclass(frozen=True)
class Order:
    """The order of a stream, and the share of this process in it; see `stream_episodes`."""

    buffer: int
    """The rows that are shuffled together, 0 for none."""
    seed: int
    rank: int
    ranks: int

    @classmethod
    def of(cls, shuffle: Any, seed: Any, rank: Any, world_size: Any) -> Order:
        """Return the order that a caller asks for; ranks are torchrun's unless they are given.

        Raises:
            ValueError: An argument has a value that is not allowed.
        """
        if isinstance(shuffle, bool):
            buffer = BUFFER * shuffle
        else:
            allowed = "True, False or a number of rows from 1 on"
            buffer = whole("shuffle", shuffle, 1, allowed=allowed)
        return cls(buffer, whole("seed", seed, 0), *_share_of_ranks(rank, world_size))


def _share_of_ranks(rank: Any, ranks: Any) -> tuple[int, int]:
    """Return the rank of this process and the number of ranks, perhaps of torchrun."""
    if rank is not None or ranks is not None:
        ranks = whole("world_size", ranks, 1)
        return whole("rank", rank, 0, ranks - 1), ranks
    given = os.environ.get("RANK"), os.environ.get("WORLD_SIZE", "1")
    rank, ranks = (int(text) if text and text.isdecimal() else text for text in given)
    ranks = whole("WORLD_SIZE", ranks, 1)
    if rank is None and ranks == 1:
        return 0, 1
    allowed = f"a whole number from 0 to {ranks - 1}, as WORLD_SIZE={ranks}; or rank=, world_size="
    return whole("RANK", rank, 0, ranks - 1, allowed=allowed), ranks


class Stream(Generic[Item]):
    """Episodes or transitions of a split, which may be iterated once an epoch.

    Pass it to a `DataLoader` as it is, after importing torch. `next` takes items without `iter`.
    """

    def __init__(
        self,
        part: Part,
        spec: ObservationSpec,
        items_of: Callable[[Iterable[LoadedEpisode]], Iterator[Item]],
        order: Order,
    ) -> None:
        self._part, self._spec, self._items_of, self._order = part, spec, items_of, order
        self._epoch: Any = np.zeros((), np.int64)
        self._at: dict[str, Any] | None = None
        self._loaded = False
        self._running: Iterator[Item] | None = None
        if hasattr(sys.modules.get("torch.utils.data"), "IterableDataset"):
            sys.modules["torch.utils.data"].IterableDataset.register(type(self))
            # Workers that live for several epochs see the number that the main process sets.
            torch = sys.modules["torch"]
            self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    def __iter__(self) -> Iterator[Item]:
        """Begin the epoch, or go on where `load_state_dict` says."""
        at = self.state_dict() if self._loaded else self._start()
        self._check(at)
        self._at, self._loaded = at, False
        return self._items(at)

    def __next__(self) -> Item:
        """Return the next item of an iteration that the first call begins."""
        if self._running is None:
            self._running = iter(self)
        return next(self._running)

    def __len__(self) -> int:
        """Raise TypeError, with what to do where a `DataLoader` asks for the length to iterate."""
        raise TypeError(
            "a stream has no length; if a DataLoader asks for it in order to iterate, the stream "
            "was made before torch was imported: import torch first"
        )

    def __bool__(self) -> bool:
        """Return True, without asking for the length."""
        return True

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process is sent."""
        return vars(self) | {"_running": None}

    def close(self) -> None:
        """End the iteration of `next`."""
        self._running = iter(())

    def set_epoch(self, epoch: int) -> None:
        """Choose the order of the next iteration; a shuffled stream has another in each epoch.

        Raises:
            ValueError: The epoch is not a whole number from 0 on.
        """
        epoch = whole("epoch", epoch, 0)
        if epoch != int(self._epoch):
            self._at, self._loaded = None, False
        self._epoch[...] = epoch

    def state_dict(self) -> dict[str, Any]:
        """Return the place after the last item: a few numbers, which JSON holds, too."""
        return dict(self._at or self._start())

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on after the item at which `state_dict` was called, in the next iteration.

        Raises:
            ValueError: The state is not one of a stream with the same rows, order and share.
        """
        at = dict(state)
        self._check(at)
        self._epoch[...] = at["epoch"]
        self._at, self._loaded = at, True

    def _start(self) -> dict[str, Any]:
        return {"stream": self._name(), "epoch": int(self._epoch), "shard": 0, "part": 0, "item": 0}

    def _check(self, at: Mapping[str, Any]) -> None:
        start = self._start()
        numbers = [at.get(name) for name in start if name != "stream"]
        if at.keys() != start.keys() or not all(type(n) is int and n >= 0 for n in numbers):
            raise ValueError(f"load_state_dict: {at!r:.99} is not what state_dict gave")
        if at["stream"] != start["stream"]:
            raise ValueError(
                "load_state_dict: the state is of another stream: give the same rows, observation, "
                "shuffle, seed, world_size and number of workers, and each worker its own state"
            )

    def _name(self) -> str:
        """Return a hash of all that the order and the share of this process depend on."""
        order = self._order.buffer, self._order.seed, *self._share()
        key = self._part.key(), self._spec.decodes, self._items_of.__name__, order
        return hashlib.sha256(repr(key).encode()).hexdigest()[:16]

    def _share(self) -> tuple[int, int]:
        """Return the number of this process among all ranks and workers, and how many there are."""
        torch_data = sys.modules.get("torch.utils.data")
        worker = None if torch_data is None else torch_data.get_worker_info()
        number, workers = (0, 1) if worker is None else (worker.id, worker.num_workers)
        return self._order.rank * workers + number, self._order.ranks * workers

    def _random(self, at: Mapping[str, Any], *more: int) -> np.random.Generator:
        return np.random.default_rng([self._order.seed, at["epoch"], *more])

    def _permutation(self, count: int, at: Mapping[str, Any], *more: int) -> NDArray[np.int64]:
        """Return the order of some things in an epoch, random if the stream is shuffled."""
        if not self._order.buffer:
            return np.arange(count)
        return self._random(at, *more).permutation(count)

    def _items(self, at: dict[str, Any]) -> Iterator[Item]:
        """Yield items from a place on, and keep the place up to date."""
        part, (share, shares) = self._part, self._share()
        rows = part.counts()
        total = int(rows.sum())
        own = range(total * share // shares, total * (share + 1) // shares)
        order = self._permutation(len(rows), at)
        ends = np.cumsum(rows[order]).tolist()
        for place, number in islice(enumerate(order.tolist()), at["shard"], None):
            first = ends[place] - int(rows[number])
            if first < own.stop and ends[place] > own.start:
                with part.opened(number) as file:
                    for groups in self._parts(file, number, first, own, at)[at["part"] :]:
                        # Without a name, so that they are free before others are read.
                        for item in islice(self._read(file, number, groups, at), at["item"], None):
                            at["item"] += 1
                            yield item
                        at.update(part=at["part"] + 1, item=0)
            at.update(shard=place + 1, part=0, item=0)

    def _parts(
        self, file: ParquetFile, number: int, before: int, own: range, at: Mapping[str, Any]
    ) -> list[list[int]]:
        """Return the row groups of a shard that are this process's, by those read together.

        Args:
            file: The shard.
            number: Its number.
            before: How many rows there are before it in the order of the epoch.
            own: The numbers in this order of the rows that are this process's.
            at: The place, with the number of the epoch.
        """
        units, rows = self._part.units(file, number)
        order = self._permutation(len(units), at, number)
        # A unit is whose the row in its middle is.
        middle = before + np.cumsum(rows[order]) - (rows[order] + 1) // 2
        mine = (own.start <= middle) & (middle < own.stop) & (rows[order] > 0)
        cost, limit = rows.tolist(), self._order.buffer
        if not limit and self._spec.decodes:
            sizes = [file.metadata.row_group(n).total_byte_size for n in range(file.num_row_groups)]
            cost, limit = [sum(sizes[unit.start : unit.stop]) for unit in units], TOGETHER_BYTES
        elif not limit:
            cost, limit = [len(unit) for unit in units], TOGETHER
        parts: list[list[int]] = []
        held = limit
        for unit in order[mine].tolist():
            if held + cost[unit] > limit:
                parts.append([])
                held = 0
            parts[-1] += units[unit]
            held += cost[unit]
        return parts

    def _read(
        self, file: ParquetFile, number: int, groups: list[int], at: Mapping[str, Any]
    ) -> Iterator[Item]:
        """Return the items of row groups, in random order if the stream is shuffled."""
        spec, part = self._spec, self._part
        blocks = part.rows_of(file, number, sorted(groups), pictures=spec.decodes)
        items = self._items_of(episodes_of(blocks, spec, part.config))
        if not self._order.buffer:
            return items
        every = [*items]
        shuffled = self._random(at, number, 1 + groups[0]).permutation(len(every))
        return map(every.__getitem__, shuffled.tolist())


def _whole_episodes(episodes: Iterable[LoadedEpisode]) -> Iterator[LoadedEpisode]:
    return iter(episodes)


def _steps(episodes: Iterable[LoadedEpisode]) -> Iterator[Transition]:
    for episode in episodes:
        observations = episode.observations
        for step, action in enumerate(episode.actions.tolist()):
            yield Transition(observations[step], action, observations[step + 1])


def stream_episodes(  # noqa: D417
    source: str | Path,
    config: str,
    *,
    split: str = "train",
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    draw: bool = False,
    resize: str = "area",
    revision: str | None = None,
    labyrinths: int | None = None,
    where: Filter | None = None,
    shuffle: bool | int = False,
    seed: int = 0,
    rank: int | None = None,
    world_size: int | None = None,
) -> Stream[LoadedEpisode]:
    """Return the episodes of a split as they are read, to be iterated once an epoch.

    From the Hub only the row groups and columns that are needed are downloaded. Each row group
    goes to one of the workers of a `DataLoader` and one of the ranks, so that all together get
    every episode once an epoch; their shares differ by about a row group. `set_epoch` chooses
    the order, `state_dict` and `load_state_dict` go on after the last item. A `DataLoader` takes a
    stream for one only if torch was imported before the stream was made.

    Args:
        source: Folder with the dataset, or its id on the Hub; see `load_episodes` for this and
            for all arguments that are not explained here.
        config: Name of the dataset's config, such as `5x5`.
        shuffle: Whether shards, the row groups in each, and the items of consecutive row groups
            come in random order; a number says how many rows are held for the latter, True 4,096.
        seed: The order follows from this number and the epoch.
        rank: Number of this process, from 0; by default torchrun's `RANK`.
        world_size: Number of processes; by default torchrun's `WORLD_SIZE`. Where another library
            divides what it is given among ranks, give `rank=0, world_size=1`.

    Raises:
        ValueError: An argument has a value that is not allowed.
        DatasetError: As for `load_episodes`; raised for rows after the items before them.
    """
    order = Order.of(shuffle, seed, rank, world_size)
    spec = ObservationSpec(observation, image_size, draw, resize)
    wanted = Wanted(source, config, split, revision, labyrinths, where)
    return Stream(find_part(wanted, in_place=True), spec, _whole_episodes, order)


def stream_transitions(
    source: str | Path,
    config: str,
    *,
    split: str = "train",
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    draw: bool = False,
    resize: str = "area",
    revision: str | None = None,
    labyrinths: int | None = None,
    where: Filter | None = None,
    shuffle: bool | int = False,
    seed: int = 0,
    rank: int | None = None,
    world_size: int | None = None,
) -> Stream[Transition]:
    """Return the transitions of a split as they are read; see `stream_episodes`."""
    order = Order.of(shuffle, seed, rank, world_size)
    spec = ObservationSpec(observation, image_size, draw, resize)
    wanted = Wanted(source, config, split, revision, labyrinths, where)
    return Stream(find_part(wanted, in_place=True), spec, _steps, order)
