"""The figures of a certificate: shares of test in train, levels, and test seeds of new levels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from labyrinth_core.benchmarks.errors import CertifyError
from labyrinth_core.benchmarks.levels import Levels, Share, curve, shared
from labyrinth_core.benchmarks.memory import Memory
from labyrinth_core.benchmarks.records import Split
from labyrinth_core.benchmarks.spread import Spread

LEVELS = ("state", "probes", "first")
"""The measures that can tell levels apart, the best first."""


@dataclass(frozen=True)
class Figures:
    """How many levels of test are in train, how many levels there are, and what limits this."""

    environment: str
    """The name of the environment, dataset or file."""
    arguments: Mapping[str, Any]
    """The arguments of `certify` that give this certificate again."""
    versions: Mapping[str, str]
    """Package -> version, of the environment's and the others that matter."""
    train: Split
    test: Split
    reasons: Mapping[str, str] = field(default_factory=dict)
    """Measure that cannot stand -> the reason."""
    checked: str = ""
    """Which seeds were played again, and how."""
    notes: tuple[str, ...] = ()
    """What limits the measures that stand."""
    state_function: str = ""
    """The name of the state function: minigrid, labyrinth, or that of the caller's."""
    spread: Spread | None = None
    """None if first observations are not arrays, or differ in size."""
    memory: Memory | None = None
    """None without a policy and demonstrations."""
    unit: str = "seed"
    """What is counted: seeds, or the episodes of a dataset."""

    @cached_property
    def measures(self) -> Mapping[str, Share]:
        """Measure that stands -> the share of test in train: first, probes, state.

        A Minari dataset has seeds, first and actions instead.
        """
        return {
            measure: shared(self.train.digests[measure], self.test.digests[measure])
            for measure in self.train.digests
            if measure in self.test.digests and measure not in self.reasons
        }

    @property
    def first(self) -> Share | None:
        """Test seeds whose first observation is one of train's; None if it cannot stand."""
        return self.measures.get("first")

    @property
    def probes(self) -> Share | None:
        """Test seeds that the probes cannot tell from a train seed; None if it cannot stand."""
        return self.measures.get("probes")

    @property
    def state(self) -> Share | None:
        """Test seeds with the state of a train seed; None if unknown or if it cannot stand."""
        return self.measures.get("state")

    @cached_property
    def levels(self) -> Levels | None:
        """The levels of train and test together, told apart by the best measure that stands."""
        by = next((measure for measure in LEVELS if measure in self.measures), None)
        if by is None:
            return None
        new = ~np.isin(np.array(self.test.seeds), np.array(self.train.seeds))
        digests = self.train.digests[by], self.test.digests[by][new]
        return Levels.of(by, np.concatenate(digests), self.unit)

    @cached_property
    def curves(self) -> Mapping[str, tuple[tuple[int, int], ...]]:
        """Measure -> pairs (m, count): test seeds that are among the first m seeds of train."""
        return {
            measure: curve(self.train.digests[measure], self.test.digests[measure])
            for measure in self.measures
        }

    def disjoint(self, count: int = 1) -> list[int]:
        """Return all test seeds whose levels are neither in train nor repeated.

        Two seeds have the same level if the probes cannot tell them apart or their states are
        equal; by their first observations only if neither probes nor states are known.

        Args:
            count: The number of seeds that are needed.

        Raises:
            CertifyError: There are fewer; the message says how many levels there are.
        """
        if self.levels is None:
            reason = next(iter(self.reasons.values()), "no measure is known")
            raise CertifyError(f"{self.environment}: no level can be told from another: {reason}")
        by = [measure for measure in LEVELS[:2] if measure in self.measures] or [LEVELS[2]]
        usable = np.ones(len(self.test.seeds), bool)
        for measure in by:
            train, test = self.train.digests[measure], self.test.digests[measure]
            first = np.zeros(len(test), bool)
            first[np.unique(test, return_index=True)[1]] = True
            usable &= first & ~np.isin(test, train)
        seeds = [seed for seed, use in zip(self.test.seeds, usable.tolist(), strict=True) if use]
        if len(seeds) < count:
            raise CertifyError(
                f"{self.environment}: {len(seeds):,} of {len(usable):,} test {self.unit}s have "
                f"levels that are neither in train nor repeated, and {count:,} are needed; "
                f"{self.levels}"
            )
        return seeds
