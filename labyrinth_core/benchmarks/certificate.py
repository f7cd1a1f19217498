"""The certificate of a benchmark: its figures, in words, and the forms in which they are kept."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from labyrinth_core.benchmarks.environment import CertifyError, text_of
from labyrinth_core.benchmarks.levels import Levels, Share, Spread, curve, percent, shared
from labyrinth_core.benchmarks.memory import Memory
from labyrinth_core.benchmarks.records import Split, json_lines, parquet, rows_of
from labyrinth_core.storage import File

FORMAT = 1
"""The format of a certificate's JSON."""

LEVELS = ("state", "probes", "first")
"""The measures that can tell levels apart, the best first."""

FAILED_SHOWN = 5
"""The maximum number of failed seeds of a split that are named."""
LONGEST_SEEDS = 60
"""The maximum length of the text of a split's seeds."""

NAMES = {
    "first": "first observation",
    "probes": "probes",
    "state": "state",
    "seeds": "recorded seed",
    "actions": "whole action sequence",
}
"""Measure -> what is in train."""

CLAUSES = {
    "first": "{} begin with the first observation of a training {unit}",
    "probes": "{} cannot be told from a training {unit} along {probes}",
    "state": "{} have the state of a training {unit}",
    "seeds": "{} were recorded with the seed of a training {unit}",
    "actions": "{} repeat the whole action sequence of a training {unit}",
}
"""Measure -> a clause about test."""


@dataclass(frozen=True, repr=False)
class Certificate:
    """How many levels of test are in train, how many levels there are, and what limits this.

    Printing it shows all figures; `sentence` is for a paper.
    """

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

    @property
    def sentence(self) -> str:
        """What to write in a paper."""
        unit = self.unit
        versions = ", ".join(f"{name} {value}" for name, value in self.versions.items())
        of = self.environment + (f" ({versions})" if versions else "")
        if not self.measures:
            reason = next(iter(self.reasons.values()), "nothing was recorded")
            return f"The share of test levels of {of} in train cannot be given: {reason}."
        clauses = [
            CLAUSES[measure].format(_counted(share), unit=unit, probes=self._probes())
            for measure, share in self.measures.items()
        ]
        listed = ", ".join(clauses[:-1]) + (" and " if clauses[1:] else "") + clauses[-1]
        splits = f"{self._split('test')} of {of}, with {self._split('train')}"
        parts = [f"Of the {splits}, {listed}"]
        if self.levels is not None:
            parts.append(str(self.levels))
        parts += [f"no share by {NAMES[measure]} can be given" for measure in self.reasons]
        parts += self.notes
        return "; ".join(parts) + "."

    @property
    def markdown(self) -> str:
        """The certificate as a Markdown section."""
        cells = [(a, b.replace("|", r"\|")) for a, b in self._rows()]
        lines = [f"| {a} | {b} |" for a, b in cells]
        table = "\n".join(["| | |", "|---|---|", *lines])
        return f"## {self._title()}\n\n{self.sentence}\n\n{table}\n"

    def __repr__(self) -> str:
        """Return all figures as text."""
        lines = [*self._rows()]
        width = max(len(label) for label, _ in lines)
        return "\n".join([self._title(), *(f"  {a:{width}}  {b}" for a, b in lines)])

    def _rows(self) -> Iterator[tuple[str, str]]:
        """Yield the label and the text of each line of the certificate."""
        for measure, share in self.measures.items():
            yield NAMES[measure], f"{share} of test in train"
        for measure, reason in self.reasons.items():
            yield NAMES[measure], f"no share: {reason}"
        if self.levels is not None:
            yield "levels", str(self.levels)
            yield "curve", self._curve(self.levels.by)
        if (spread := self.spread) is not None:
            yield (
                "spread",
                f"two first observations are {100 * spread.share:.2g}% of a value's range apart "
                f"(of {spread.seeds:,} seeds; number of values that change: {spread.values:,})",
            )
        if (memory := self.memory) is not None:
            yield "memory", f"solves {memory.memory}; {memory.known} begin like a demonstration"
            if memory.policy is not None:
                yield "the policy", f"solves {memory.policy}"
            yield "random actions", f"solve {memory.random}"
        if self.levels is not None:
            disjoint = len(self.disjoint(0))
            yield "disjoint", f"{disjoint:,} test {self.unit}s, neither in train nor repeated"
        if self.checked:
            yield f"{self.unit}s", self.checked
        for note in self.notes:
            yield "note", note
        for name, split in (("train", self.train), ("test", self.test)):
            for seed, reason in split.failed[:FAILED_SHOWN]:
                yield "failed", f"{name} seed {seed}: {reason}"
            if len(split.failed) > FAILED_SHOWN:
                yield "failed", f"and {len(split.failed) - FAILED_SHOWN:,} more of {name}"

    def _curve(self, by: str) -> str:
        of = len(self.test.seeds)
        points = [
            f"{percent(count / of)}% with {m:,}"
            for m, count in self.curves[by]
            if m >= 10 or m == len(self.train.seeds)
        ]
        return f"of test in train, with so many train {self.unit}s: {', '.join(points)}"

    def _title(self) -> str:
        """Return the name of the environment and the sizes of its splits."""
        splits = ", ".join(self._split(name) for name in ("train", "test"))
        return f"{self.environment}: {splits}"

    def _split(self, name: str) -> str:
        split = self.train if name == "train" else self.test
        seeds = text_of(split.seeds) if self.unit == "seed" else ""
        shown = f" ({seeds})" if 0 < len(seeds) <= LONGEST_SEEDS else ""
        count = len(split.seeds)
        return f"{count:,} {name} {self.unit}{'' if count == 1 else 's'}{shown}"

    def _probes(self) -> str:
        """Return how the probes were made."""
        asked = self.arguments
        if "probes" not in asked:
            return "the recorded probes"
        sequences = f"{asked['probes']} random action sequence{'' if asked['probes'] == 1 else 's'}"
        return f"{sequences} of {asked['steps']} step{'' if asked['steps'] == 1 else 's'}"

    @property
    def records(self) -> bytes:
        """The digests of all seeds as JSON lines, as `certify` reads them."""
        head = {"environment": self.environment, "versions": dict(self.versions)}
        return json_lines([head, *rows_of({"train": self.train, "test": self.test})])

    def to_json(self) -> dict[str, Any]:
        """Return everything but the digests as plain types; the same arguments give it again."""
        levels, memory = self.levels, self.memory and vars(self.memory)
        estimates = ("coverage", "at_least", "interval")
        return {
            "format": FORMAT,
            "environment": self.environment,
            "arguments": dict(self.arguments),
            "versions": dict(self.versions),
            "state_function": self.state_function,
            "checked": self.checked,
            "notes": [*self.notes],
            "measures": {name: _share(share) for name, share in self.measures.items()},
            "reasons": dict(self.reasons),
            "levels": levels
            and asdict(levels) | {name: getattr(levels, name) for name in estimates},
            "curves": {name: [[*pair] for pair in pairs] for name, pairs in self.curves.items()},
            "spread": self.spread and asdict(self.spread),
            "memory": memory
            and {
                name: _share(value) if isinstance(value, Share) else value
                for name, value in memory.items()
            },
            "failed": {"train": [*self.train.failed], "test": [*self.test.failed]},
            "disjoint": [] if levels is None else self.disjoint(0),
            "records_sha256": sha256(self.records).hexdigest(),
            "sentence": self.sentence,
        }

    def save(self, path: str | Path) -> None:
        """Write the certificate to a file, in the form that its name ends in.

        Args:
            path: `.json` for all figures and the disjoint seeds; `.md` for a Markdown section;
                `.jsonl` or `.parquet` for the digests of all seeds, which `certify` reads.

        Raises:
            CertifyError: The name of the file has another end.
            OSError: The file cannot be written.
        """
        path = Path(path)
        if path.suffix == ".json":
            content = (json.dumps(self.to_json(), indent=1) + "\n").encode()
        elif path.suffix == ".md":
            content = self.markdown.encode()
        elif path.suffix == ".jsonl":
            content = self.records
        elif path.suffix == ".parquet":
            head, *rows = map(json.loads, self.records.splitlines())
            content = parquet(head, rows)
        else:
            raise CertifyError(f"{path}: give a name that ends in .json, .md, .jsonl or .parquet")
        File(path).write_bytes(content)


def _share(share: Share) -> dict[str, Any]:
    return asdict(share) | {"share": share.share, "interval": [*share.interval]}


def _counted(share: Share) -> str:
    low, high = (percent(bound) for bound in share.interval)
    return f"{share.count:,} ({percent(share.share)}%, 95% interval {low} to {high}%)"
