"""The certificate of a benchmark: its figures, and the forms in which they are kept."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from labyrinth_core.benchmarks import wording
from labyrinth_core.benchmarks.errors import CertifyError
from labyrinth_core.benchmarks.figures import Figures
from labyrinth_core.benchmarks.levels import Share
from labyrinth_core.benchmarks.records import json_lines, parquet, rows_of
from labyrinth_core.storage import File

FORMAT = 1
"""The format of a certificate's JSON."""


@dataclass(frozen=True, repr=False)
class Certificate(Figures):
    """How many levels of test are in train, how many levels there are, and what limits this.

    Printing it shows all figures; `sentence` is for a paper.
    """

    @property
    def sentence(self) -> str:
        """What to write in a paper."""
        return wording.sentence(self)

    @property
    def markdown(self) -> str:
        """The certificate as a Markdown section."""
        return wording.markdown(self)

    def __repr__(self) -> str:
        """Return all figures as text."""
        return wording.text(self)

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
