"""The counts of a dataset: all that is counted in its rows, and the file that keeps it.

The stage `analyse` leaves them in `counts.json` in the dataset's folder, where card and report
find them. Where there are none, or those of other shards, they are counted anew, and the card
leaves them, too.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import MALFORMED
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.storage import AnyPath, write_text
from labyrinth_core.language.text import dump, parse
from labyrinth_core.world.labyrinth import Labyrinth
from pipeline.inspection.certificate import Certificate, Pair
from pipeline.machinery.schema import read_json

COUNTS = "counts.json"
"""The name of the file."""
FORMAT = 1

EXAMPLES = 5
"""The number of labyrinths of each split that are kept as examples, for pictures."""


class Example(NamedTuple):
    """A labyrinth of a split with its first episode."""

    labyrinth: Labyrinth
    actions: tuple[int, ...]


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
            content = read_json(folder / COUNTS)
            if content | _described(manifest) != content:
                return None
            splits = {
                split: SplitCounts.from_json(content["splits"][split])
                for split in manifest.config.splits
            }
            certificate = content["certificate"]
            pairs = tuple(Pair(**pair) for pair in certificate["pairs"])
            return cls(splits, Certificate(**certificate | {"pairs": pairs}))
        except (FileNotFoundError, *MALFORMED):
            return None  # Missing or damaged.


def _described(manifest: Manifest) -> dict[str, Any]:
    """Return what the file says of the dataset whose counts it holds."""
    return {
        "format": FORMAT,
        "name": manifest.config.name,
        "fingerprint": manifest.fingerprint,
        "shards": {shard.path: shard.sha256 for shard in manifest.shards},
    }
