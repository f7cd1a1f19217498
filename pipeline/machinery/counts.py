"""The counts of a dataset: all that is counted in its rows, in one pass, and kept in one file.

The stage `analyse` leaves them in `counts.json` in the dataset's folder, where card and report
find them. Where there are none, or those of other shards, they are counted anew, and the card
leaves them, too. What is in memory meanwhile is a shard's labyrinths, and three numbers of each
labyrinth for the certificate.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import SPLITS
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.manifest import Manifest, Shard
from labyrinth_core.data.storage import AnyPath, file_sha256, write_text
from labyrinth_core.language.text import dump, parse
from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.solver import optimal_actions
from pipeline.machinery.certificate import Certificate, Keys, Pair, certify, size_of
from pipeline.machinery.executor import ordered_map
from pipeline.machinery.routes import Route, routes_of

COUNTS = "counts.json"
"""The name of the file."""
FORMAT = 1

EXAMPLES = 5
"""The number of labyrinths of each split that are kept as examples, for pictures."""


class Example(NamedTuple):
    """A labyrinth of a split with its first episode."""

    labyrinth: Labyrinth
    actions: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Content:
    """The labyrinths of a split, in order, and what all episodes in each do together."""

    labyrinths: tuple[Labyrinth, ...]
    moves: NDArray[np.int64]
    """The number of moves of a shortest route, shape (labyrinths,)."""
    actions: NDArray[np.int64]
    """How often each action is taken, shape (labyrinths, 4)."""
    visits: NDArray[np.int64]
    """States with the agent in each cell, shape (labyrinths, height, width)."""

    @classmethod
    def joined(cls, parts: Sequence[Content]) -> Content:
        """Return the content of shards that follow one another."""
        return cls(
            tuple(each for part in parts for each in part.labyrinths),
            np.concatenate([part.moves for part in parts]),
            np.concatenate([part.actions for part in parts]),
            np.concatenate([part.visits for part in parts]),
        )


@dataclass(eq=False)
class SplitCounts:
    """The counts of a split or of a shard."""

    actions: NDArray[np.int64]
    """How often each action is taken, shape (4,)."""
    visits: NDArray[np.int64]
    """Rows with the agent in each cell, shape (height, width), row 0 at the bottom."""
    labyrinths: int
    lengths: Counter[int]
    """Number of moves -> episodes of that many."""
    moves: Counter[int]
    """Number of moves of a shortest route -> labyrinths."""
    loops: Counter[int]
    """Passages beyond those of a tree (passages - cells + 1) -> labyrinths."""
    junctions: Counter[int]
    """Cells where ways part -> labyrinths."""
    returned: float
    """The sum of all rewards."""
    choices: int
    """The number of optimal actions, summed over the states acted in."""
    optimal: int
    """The number of actions taken that are optimal."""
    examples: list[Example]
    """The first `EXAMPLES` labyrinths."""

    @property
    def episodes(self) -> int:
        """The number of episodes."""
        return self.lengths.total()

    @property
    def rows(self) -> int:
        """The number of rows, one for each state of an episode."""
        return int(self.visits.sum())

    @property
    def longest(self) -> int:
        """The number of moves of the longest episode."""
        return max(self.lengths)

    @property
    def mean_moves(self) -> float:
        """The mean number of moves of an episode."""
        return int(self.actions.sum()) / self.episodes

    @property
    def mean_return(self) -> float:
        """The mean return of an episode."""
        return self.returned / self.episodes

    @property
    def mean_loops(self) -> float:
        """The mean number of loops of a labyrinth."""
        return sum(loops * count for loops, count in self.loops.items()) / self.labyrinths

    @property
    def mean_choices(self) -> float:
        """The mean number of optimal actions in a state, over the states acted in."""
        return self.choices / int(self.actions.sum())

    @property
    def optimal_share(self) -> float:
        """The share of the actions that are optimal."""
        return self.optimal / int(self.actions.sum())

    @property
    def action_shares(self) -> NDArray[np.float64]:
        """The share of each action, shape (4,)."""
        shares: NDArray[np.float64] = self.actions / self.actions.sum()
        return shares

    def add(self, other: SplitCounts) -> None:
        """Add the counts of the shard that follows."""
        for each in fields(self):
            setattr(self, each.name, getattr(self, each.name) + getattr(other, each.name))
        self.examples = self.examples[:EXAMPLES]

    def to_json(self) -> dict[str, Any]:
        """Return the counts in plain types; counters as sorted pairs."""
        values = dict(vars(self))
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                values[name] = value.tolist()
            elif isinstance(value, Counter):
                values[name] = sorted(value.items())
        examples = [(dump(labyrinth), actions) for labyrinth, actions in self.examples]
        return values | {"examples": examples}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> SplitCounts:
        """Return the counts that `to_json` described.

        Raises:
            ValueError, LookupError, TypeError: They are something else.
        """
        known = dict(values)
        for name in ("actions", "visits"):
            known[name] = np.array(known[name], np.int64)
        for name in ("lengths", "moves", "loops", "junctions"):
            known[name] = Counter(dict(known[name]))
        known["examples"] = [Example(parse(text), tuple(of)) for text, of in known["examples"]]
        return cls(**known)


@dataclass(frozen=True)
class DatasetCounts:
    """The counts of a dataset."""

    splits: Mapping[str, SplitCounts]
    """Split -> its counts, in the order of the table of splits."""
    certificate: Certificate

    def write(self, folder: AnyPath, manifest: Manifest) -> None:
        """Write the counts into the folder of their dataset, all or nothing."""
        content = _described(manifest) | {
            "splits": {split: counts.to_json() for split, counts in self.splits.items()},
            "certificate": asdict(self.certificate),
        }
        write_text(folder / COUNTS, json.dumps(content) + "\n")

    @classmethod
    def read(cls, folder: AnyPath, manifest: Manifest) -> DatasetCounts | None:
        """Return the counts in a folder, None if there are none of its shards as they are now."""
        try:
            content = json.loads((folder / COUNTS).read_bytes())
            if content | _described(manifest) != content:
                return None
            splits = {split: SplitCounts.from_json(content["splits"][split]) for split in SPLITS}
            certificate = content["certificate"]
            pairs = tuple(Pair(**pair) for pair in certificate["pairs"])
            return cls(splits, Certificate(**certificate | {"pairs": pairs}))
        except FileNotFoundError:
            return None
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError):  # Damaged.
            return None


def _described(manifest: Manifest) -> dict[str, Any]:
    """Return what the file says of the dataset whose counts it holds."""
    return {
        "format": FORMAT,
        "name": manifest.config.name,
        "fingerprint": manifest.fingerprint,
        "shards": {shard.path: shard.sha256 for shard in manifest.shards},
    }


class Counted(NamedTuple):
    """What one pass over some episodes finds."""

    counts: SplitCounts
    keys: Keys
    content: Content


def count_routes(routes: Iterable[Route], size: tuple[int, int]) -> Counted:
    """Return the counts of episodes.

    Args:
        routes: The episodes; those of a labyrinth follow one another.
        size: Height and width of all labyrinths.

    Raises:
        ValueError: A labyrinth is of another size.
    """
    labyrinths: list[Labyrinth] = []
    examples: list[Example] = []
    moves, actions, visits = [], [], []
    lengths: Counter[int] = Counter()
    returned, choices, optimal = 0.0, 0, 0
    cells = size[0] * size[1]
    for route in routes:
        if route.is_first:
            if size_of(route.labyrinth) != size:
                held = route.labyrinth.size_name
                raise ValueError(f"a labyrinth is {held}, not {size[0]}x{size[1]}")
            labyrinths.append(route.labyrinth)
            moves.append(route.shortest)
            actions.append(np.zeros(len(Action), np.int64))
            visits.append(np.zeros(cells, np.int64))
            best = optimal_actions(route.labyrinth)
            if len(examples) < EXAMPLES:
                examples.append(Example(route.labyrinth, tuple(route.actions)))
        taken = np.array(route.actions, np.int64)
        states = np.array(route.states)
        actions[-1] += np.bincount(taken, minlength=len(Action))
        visits[-1] += np.bincount(states % cells, minlength=cells)
        choices += int(best[states[:-1]].sum())
        optimal += int(best[states[:-1], taken].sum())
        lengths[len(taken)] += 1
        returned += route.returned
    content = Content(
        tuple(labyrinths),
        np.array(moves, np.int64),
        np.array(actions, np.int64).reshape(-1, len(Action)),
        np.array(visits, np.int64).reshape(-1, *size),
    )
    counts = SplitCounts(
        actions=content.actions.sum(axis=0),
        visits=content.visits.sum(axis=0),
        labyrinths=len(labyrinths),
        lengths=lengths,
        moves=Counter(moves),
        loops=Counter(each.structure.loops for each in labyrinths),
        junctions=Counter(each.structure.junctions for each in labyrinths),
        returned=returned,
        choices=choices,
        optimal=optimal,
        examples=examples,
    )
    return Counted(counts, Keys.of(labyrinths), content)


def count_shard(folder: AnyPath, size: tuple[int, int], shard: Shard) -> Counted:
    """Return the counts of one shard.

    Raises:
        DatasetError: The file is missing, damaged, or not the manifest's.
    """
    try:
        counted = count_routes(routes_of(folder, shard), size)
    except ValueError as error:
        raise DatasetError(f"{folder / shard.path} cannot be read: {error}") from error
    counts = counted.counts
    found = (counts.labyrinths, counts.episodes, counts.rows)
    if not counts.rows or found != (shard.labyrinths, shard.episodes, shard.rows):
        raise DatasetError(
            f"{folder / shard.path} holds {found[0]} labyrinths, {found[1]} episodes and "
            f"{found[2]} rows, which is not what its manifest says: build again"
        )
    return counted


def count_dataset(
    folder: AnyPath,
    manifest: Manifest,
    workers: int = 1,
    advance: Callable[[int], None] = lambda _: None,
    keep: Callable[[str, Content], None] = lambda *_: None,
) -> DatasetCounts:
    """Return the counts of a dataset, counted in its shards.

    Args:
        folder: The folder with its shards.
        manifest: Its manifest.
        workers: The number of processes.
        advance: Called after each shard with the number of its rows.
        keep: Called after each shard with the name of its split and its content.

    Raises:
        DatasetError: A shard is missing, damaged, or not the manifest's.
    """
    size = manifest.config.height, manifest.config.width
    shards = [shard for split in SPLITS for shard in manifest.of(split)]
    splits: dict[str, SplitCounts] = {}
    keys: dict[str, list[Keys]] = {split: [] for split in SPLITS}
    done = ordered_map(partial(count_shard, folder, size), shards, workers)
    for shard, counted in zip(shards, done, strict=True):
        if shard.split in splits:
            splits[shard.split].add(counted.counts)
        else:
            splits[shard.split] = counted.counts
        keys[shard.split].append(counted.keys)
        keep(shard.split, counted.content)
        advance(shard.rows)
    certificate = certify({split: Keys.joined(parts) for split, parts in keys.items()})
    return DatasetCounts(splits, certificate)


def counts_of(
    folder: AnyPath,
    manifest: Manifest,
    workers: int = 1,
    advance: Callable[[int], None] = lambda _: None,
) -> DatasetCounts:
    """Return the counts that lie in the folder of a dataset; where there are none, count.

    Args:
        folder: The folder with its shards, which are compared with the manifest in either case.
        manifest: Its manifest.
        workers: The number of processes.
        advance: Called after each shard with the number of its rows.

    Raises:
        DatasetError: A shard is missing, damaged, or not the manifest's.
    """
    counts = DatasetCounts.read(folder, manifest)
    if counts is None:
        return count_dataset(folder, manifest, workers, advance)
    for shard in manifest.shards:
        path = folder / shard.path
        try:
            if file_sha256(path) != shard.sha256:
                raise DatasetError(f"{path} is damaged: its sha256 is not the manifest's")
        except OSError as error:
            raise DatasetError(f"{path} cannot be read: {one_line(error)}") from error
        advance(shard.rows)
    return counts
