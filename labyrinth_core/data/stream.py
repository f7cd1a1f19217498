"""Streams of episodes and transitions: shuffled, divided among processes and resumable.

    from labyrinth_core import stream_transitions

    for s, a, s_next in stream_transitions("data/labyrinth", "5x5", shuffle=True):
        ...

The library `datasets` also divides a stream by row group, but it reads the file's footer again for
each (ten times the bytes at 5x5), loses its shuffle buffer on resuming, and splits long episodes.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.data.dataset import Filter, Part, Query, Source
from labyrinth_core.data.load import Episodes, LoadedEpisode, together
from labyrinth_core.data.rows import TOGETHER
from labyrinth_core.data.transitions import Transition
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE, ObservationSpec

if TYPE_CHECKING:
    from pyarrow.parquet import ParquetFile

BUFFER = 4096
"""The rows that `shuffle=True` holds; at 64 x 64 their pictures take 50 MB."""

TOGETHER_BYTES = 8 << 20
"""The uncompressed bytes of row groups with pictures that are read at once."""

MOST_EPOCH = 2**63 - 1
"""The last epoch; workers share its number as a 64-bit integer."""

Item = TypeVar("Item", covariant=True)


@dataclass(frozen=True)
class Order:
    """The order of a stream, and this process's share of it; see `stream_episodes`."""

    buffer: int
    """The rows that are shuffled together; 0 for no shuffling."""
    seed: int
    rank: int
    ranks: int

    @classmethod
    def of(cls, shuffle: Any, seed: Any, rank: Any, world_size: Any) -> Order:
        """Return the order for a caller's arguments; ranks default to torchrun's.

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
    """Return this process's rank and the number of ranks, given or from torchrun."""
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


@dataclass(frozen=True, eq=False)
class Reading(Generic[Item]):
    """What a stream reads and in which order, without the place that it has come to.

    An iteration refers to this and not to its stream, which refers to the iteration: so a stream
    that is dropped closes its file at once, not when garbage is collected.
    """

    part: Part
    spec: ObservationSpec
    items_of: Callable[[Episodes, ObservationSpec], Iterator[Item]]
    order: Order

    def start(self, epoch: int) -> dict[str, Any]:
        """Return the position before the first item of an epoch."""
        return {"stream": self._name(), "epoch": epoch, "shard": 0, "part": 0, "item": 0}

    def check(self, at: Any) -> None:
        """Raise ValueError if `at` is no position in this stream."""
        start = self.start(0)
        is_state = isinstance(at, Mapping) and at.keys() == start.keys()
        numbers = [at[name] for name in start if name != "stream"] if is_state else [None]
        if not all(type(number) is int and 0 <= number <= MOST_EPOCH for number in numbers):
            raise ValueError(f"load_state_dict: {at!r:.99} is not a result of state_dict")
        if at["stream"] != start["stream"]:
            raise ValueError(
                "load_state_dict: the state is of another stream: give the same rows, observation, "
                "shuffle, seed, world_size and number of workers, and each worker its own state"
            )
        shards = len(self.part.shards)
        self._require(
            at, at["shard"] < shards or (at["shard"], at["part"], at["item"]) == (shards, 0, 0)
        )

    def _require(self, at: Mapping[str, Any], is_there: bool) -> None:
        """Raise ValueError if the position of a loaded state is not in the stream."""
        if not is_there:
            numbers = ", ".join(f"{name}={at[name]}" for name in ("shard", "part", "item"))
            raise ValueError(f"load_state_dict: {numbers} is past the end of the stream")

    def _name(self) -> str:
        """Return a hash of everything that determines the order and this process's share."""
        order = self.order.buffer, self.order.seed, *self._share()
        key = self.part.key(), self.spec.decodes, self.items_of.__name__, order
        return hashlib.sha256(repr(key).encode()).hexdigest()[:16]

    def _share(self) -> tuple[int, int]:
        """Return this process's index among the workers of all ranks, and their number."""
        torch_data = sys.modules.get("torch.utils.data")
        worker = None if torch_data is None else torch_data.get_worker_info()
        number, workers = (0, 1) if worker is None else (worker.id, worker.num_workers)
        return self.order.rank * workers + number, self.order.ranks * workers

    def _random(self, at: Mapping[str, Any], *more: int) -> np.random.Generator:
        return np.random.default_rng([self.order.seed, at["epoch"], *more])

    def _permutation(self, count: int, at: Mapping[str, Any], *more: int) -> NDArray[np.int64]:
        """Return the order of `count` things in an epoch, random if the stream is shuffled."""
        if not self.order.buffer:
            return np.arange(count)
        return self._random(at, *more).permutation(count)

    def items(self, at: dict[str, Any]) -> Iterator[Item]:
        """Yield items from the position `at` on, and update it in place."""
        part, (share, shares) = self.part, self._share()
        rows = part.counts()
        total = int(rows.sum())
        own = range(total * share // shares, total * (share + 1) // shares)
        order = self._permutation(len(rows), at)
        ends = np.cumsum(rows[order]).tolist()
        for place, number in islice(enumerate(order.tolist()), at["shard"], None):
            first = ends[place] - int(rows[number])
            count = 0
            if first < own.stop and ends[place] > own.start:
                with part.files[number].opened() as file:
                    parts = self._parts(file, number, first, own, at)
                    count = len(parts)
                    for groups in parts[at["part"] :]:
                        # No variable holds these items, so they are freed before others are read.
                        for item in self._after(self._read(file, number, groups, at), at):
                            at["item"] += 1
                            yield item
                        at.update(part=at["part"] + 1, item=0)
            self._require(at, at["part"] == count and not at["item"])
            at.update(shard=place + 1, part=0, item=0)

    def _after(self, items: Iterator[Item], at: Mapping[str, Any]) -> Iterator[Item]:
        """Return the items after the first `at["item"]`, which were taken before."""
        taken = sum(1 for _ in islice(items, at["item"]))
        self._require(at, taken == at["item"])
        return items

    def _parts(
        self, file: ParquetFile, number: int, before: int, own: range, at: Mapping[str, Any]
    ) -> list[list[int]]:
        """Return this process's row groups of a shard, in lists that are read together.

        Args:
            file: The shard.
            number: The index of the shard in the split.
            before: The number of rows before the shard in the order of the epoch.
            own: This process's rows, as a range in that order.
            at: The position, which includes the epoch.
        """
        units, rows = self.part.units(file, number)
        order = self._permutation(len(units), at, number)
        # A unit belongs to the process that owns its middle row.
        middle = before + np.cumsum(rows[order]) - (rows[order] + 1) // 2
        mine = (own.start <= middle) & (middle < own.stop) & (rows[order] > 0)
        cost, limit = rows.tolist(), self.order.buffer
        if not limit and self.spec.decodes:
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
        spec, part = self.spec, self.part
        blocks = part.rows_of(file, number, sorted(groups), pictures=spec.decodes)
        episodes = together(blocks, spec, part.config)
        items = chain.from_iterable(self.items_of(block, spec) for block in episodes)
        if not self.order.buffer:
            return items
        every = [*items]
        shuffled = self._random(at, number, 1 + groups[0]).permutation(len(every))
        return map(every.__getitem__, shuffled.tolist())


class Stream(Generic[Item]):
    """Episodes or transitions of a split; each iteration is an epoch.

    Pass it directly to a `DataLoader`, after importing torch. `next` works without `iter`.
    """

    def __init__(
        self,
        part: Part,
        spec: ObservationSpec,
        items_of: Callable[[Episodes, ObservationSpec], Iterator[Item]],
        order: Order,
    ) -> None:
        self._reading = Reading(part, spec, items_of, order)
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
        """Begin the epoch, or resume where `load_state_dict` says."""
        at = self.state_dict() if self._loaded else self._start()
        self._reading.check(at)
        self._at, self._loaded = at, False
        return self._reading.items(at)

    def __next__(self) -> Item:
        """Return the next item; the first call begins the iteration."""
        if self._running is None:
            self._running = iter(self)
        return next(self._running)

    def __len__(self) -> int:
        """Raise TypeError, and say what to do if a `DataLoader` asked for the length."""
        raise TypeError(
            "a stream has no length; if a DataLoader asks for it in order to iterate, the stream "
            "was made before torch was imported: import torch first"
        )

    def __bool__(self) -> bool:
        """Return True, without asking for the length."""
        return True

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes to pickle or copy: a copy begins, or resumes where a state says."""
        return vars(self) | {"_running": None, "_at": self._at if self._loaded else None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set the attributes; a deep copy's workers see its epoch, too."""
        vars(self).update(state)
        if not isinstance(self._epoch, np.ndarray):
            self._epoch.share_memory_()

    def close(self) -> None:
        """End the iteration that `next` began."""
        self._running = iter(())

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch, on which the order of a shuffled stream's next iteration depends.

        If it changes, `next` begins anew.

        Raises:
            ValueError: The epoch is not a whole number from 0 to 2**63 - 1.
        """
        epoch = whole("epoch", epoch, 0, MOST_EPOCH)
        if epoch != int(self._epoch):
            self._at, self._loaded, self._running = None, False, None
        self._epoch[...] = epoch

    def state_dict(self) -> dict[str, Any]:
        """Return the position after the last item, as a small dictionary that JSON can hold."""
        return dict(self._at or self._start())

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Resume after the item at which `state_dict` was called, with the next `iter` or `next`.

        Raises:
            ValueError: The state is malformed, or of a stream with other rows, order or share. A
                position within a shard that does not exist is found when the iteration begins.
        """
        self._reading.check(state)
        self._epoch[...] = state["epoch"]
        self._at, self._loaded, self._running = dict(state), True, None

    def _start(self) -> dict[str, Any]:
        return self._reading.start(int(self._epoch))


def _whole_episodes(block: Episodes, spec: ObservationSpec) -> Iterator[LoadedEpisode]:
    return map(LoadedEpisode.copy, block.loaded(block.observed(spec)))


def _steps(block: Episodes, spec: ObservationSpec) -> Iterator[Transition]:
    """Yield the transitions of a block.

    Consecutive items share no memory, since a caller may write to them. The last item of an episode
    is a copy, since whoever holds it while the next block is read would keep this block's memory.
    """
    observations, actions = block.observed(spec), block.whole.rows.actions.tolist()
    firsts, lasts = block.whole.firsts.tolist(), block.whole.lasts.tolist()
    for first, last in zip(firsts, lasts, strict=True):
        before = [*observations[first : last - 1], observations[last - 1].copy()]
        after = observations[first + 1 : last + 1].copy()
        yield from map(Transition, before, actions[first:last], after)


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
    """Return a stream of the episodes of a split; each iteration is an epoch.

    Only the required row groups and columns are downloaded from the Hub. Each row group goes to
    one `DataLoader` worker of one rank, so that together they get every episode once per epoch;
    their shares differ by about a row group. `set_epoch` chooses the order; `state_dict` and
    `load_state_dict` resume after the last item. Import torch before you make the stream: a
    `DataLoader` does not recognise a stream that was made earlier.

    Args:
        source: Folder with the dataset, or its id on the Hub; see `load_episodes` for this and
            for all arguments that are not explained here.
        config: Name of the dataset's config, such as `5x5`.
        shuffle: Whether to shuffle shards, the row groups in each, and the items of consecutive
            row groups; a number sets how many rows are held to shuffle items (True: 4,096).
        seed: Seed of the order, which also depends on the epoch.
        rank: Rank of this process, from 0; by default torchrun's `RANK`.
        world_size: Number of processes; by default torchrun's `WORLD_SIZE`. If another library
            divides the items among ranks, give `rank=0, world_size=1`.

    Raises:
        ValueError: An argument has a value that is not allowed.
        DatasetError: As for `load_episodes`; damaged rows raise it after the items before them.
    """
    order = Order.of(shuffle, seed, rank, world_size)
    spec = ObservationSpec(observation, image_size, draw, resize)
    query = Query(Source(source, config, revision), split).filter(where, labyrinths=labyrinths)
    return episode_stream(query, spec, order)


def episode_stream(query: Query, spec: ObservationSpec, order: Order) -> Stream[LoadedEpisode]:
    """Return a stream of the episodes that a query requests; see `stream_episodes`."""
    return Stream(query.part(in_place=True), spec, _whole_episodes, order)


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
    """Return a stream of the transitions of a split; see `stream_episodes`.

    An item's arrays can be written and share memory with no other item. They keep alive the
    pictures that were read together, 8 MB at most: copy the arrays of items that you hold on to.
    """
    order = Order.of(shuffle, seed, rank, world_size)
    spec = ObservationSpec(observation, image_size, draw, resize)
    query = Query(Source(source, config, revision), split).filter(where, labyrinths=labyrinths)
    return transition_stream(query, spec, order)


def transition_stream(query: Query, spec: ObservationSpec, order: Order) -> Stream[Transition]:
    """Return a stream of the transitions that a query requests; see `stream_episodes`."""
    return Stream(query.part(in_place=True), spec, _steps, order)
