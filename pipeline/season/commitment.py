"""The commitment of a season: hashes that are published before anyone sees the test.

The secret has 256 random bits. The seed of the dataset is the first eight bytes, most significant
first, of the SHA-256 of `PREFIX`, the secret, and the config as JSON without its seed, with sorted
keys and no spaces. The dataset is not stored: it can be rebuilt from the secret.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import MALFORMED, DatasetError, one_line
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.storage import read_json
from labyrinth_core.evaluation.schema import COUNT, Named, Text, check_shape
from pipeline.config.stage import Job
from pipeline.generation.build import build
from pipeline.generation.options import BuildOptions
from pipeline.machinery.dataset import build_versions
from pipeline.season.options import SeasonStageOptions

PREFIX = b"labyrinth season, seed, version 1\n"
KIND, FORMAT = "labyrinth-season", 1
SECRET_BYTES = 32

LEAST = 16
"""The minimum number of labyrinths: fewer could be guessed and checked against published hashes.
16 of the 192 or more structures of a size can be ordered in more ways than there are seeds."""

_HASH = Text(r"[0-9a-f]{64}")
_SHAPE = {
    "kind": KIND,
    "format": FORMAT,
    "name": Text(r"[a-z0-9][a-z0-9-]{0,50}"),
    "date": Text(r"\d{4}-\d\d-\d\d"),
    "config": Named(Text(r"\w+"), None),
    "labyrinths": Named(Text(r"\w+"), COUNT),
    "secret_sha256": _HASH,
    "fingerprint": _HASH,
    "shards": Named(Text(r"[\w.-]+"), _HASH),
    "versions": Named(Text(r"[\w.-]+"), Text(r".{1,100}")),
}


@dataclass(frozen=True)
class Place:
    """The paths of a season's files."""

    public: Path
    """The folder that is published."""

    @classmethod
    def of(cls, job: Job[SeasonStageOptions]) -> Place:
        """Return the paths of the season that a run names."""
        options = job.options.season
        return cls(Path(options.folder).expanduser() / options.name)

    @property
    def season(self) -> Path:
        """The file with the season's commitment."""
        return self.public / "season.json"

    @property
    def judged(self) -> Path:
        """The public list of judged submissions."""
        return self.public / "judged.json"

    @property
    def revealed(self) -> Path:
        """The file of the secret after the reveal."""
        return self.public / "secret.txt"

    @property
    def secret(self) -> Path:
        """The file of the secret before the reveal; only its owner may read it."""
        return self.public.with_name(f"{self.public.name}.secret")

    @property
    def private(self) -> Path:
        """The folder of results and submissions until the reveal; only its owner may read it."""
        return self.public.with_name(f"{self.public.name}.private")


@dataclass(frozen=True, kw_only=True)
class Season:
    """The commitment of a season: the content of `season.json`."""

    name: str
    date: str
    config: Mapping[str, Any]
    """The options of the dataset, without its seed."""
    labyrinths: Mapping[str, int]
    """Split -> number of labyrinths."""
    secret_sha256: str
    fingerprint: str
    """The fingerprint of the dataset's values and pixels, which does not depend on compression."""
    shards: Mapping[str, str]
    """Path -> SHA-256 of the file; other library versions may compress differently."""
    versions: Mapping[str, str]
    """The library versions that wrote the shards."""

    @classmethod
    def of(cls, name: str, date: str, secret: bytes, manifest: Manifest) -> Season:
        """Return the commitment to a secret and its dataset."""
        counts = Counter[str]()
        for shard in manifest.shards:
            counts[shard.split] += shard.labyrinths
        return cls(
            name=name,
            date=date,
            config=without_seed(manifest.config),
            labyrinths=dict(counts),
            secret_sha256=hashlib.sha256(secret).hexdigest(),
            fingerprint=manifest.fingerprint,
            shards={shard.path: shard.sha256 for shard in manifest.shards},
            versions=build_versions(),
        )

    @classmethod
    def read(cls, place: Place) -> Season:
        """Read the season in a folder; raise a DatasetError if there is no valid season."""
        try:
            content = read_json(place.season)
            check_shape(content, _SHAPE)
            season = cls(**{each.name: content[each.name] for each in fields(cls)})
            season.dataset_of(b"")
        except FileNotFoundError as error:
            raise DatasetError(f"{place.public} is not a season: no {place.season.name}") from error
        except (OSError, *MALFORMED) as error:
            raise DatasetError(f"{place.season} is invalid: {one_line(error):.300}") from error
        return season

    def to_text(self) -> str:
        """Return the content of `season.json`."""
        return json.dumps({"kind": KIND, "format": FORMAT, **asdict(self)}, indent=2) + "\n"

    def require_secret(self, path: Path) -> bytes:
        """Read the secret from a file; raise a DatasetError if it is not the one committed to."""
        try:
            secret = bytes.fromhex(path.read_text(encoding="ascii"))
        except FileNotFoundError as error:
            raise DatasetError(f"{path}, the season's secret, does not exist") from error
        except (OSError, ValueError):
            raise DatasetError(f"{path} holds no secret") from None  # Must not print the content.
        if hashlib.sha256(secret).hexdigest() != self.secret_sha256:
            raise DatasetError(f"{path} holds another secret than the season commits to")
        return secret

    def dataset_of(self, secret: bytes) -> DatasetConfig:
        """Return the config of the dataset that follows from a secret."""
        return DatasetConfig.from_json({**self.config, "seed": seed_of(secret, self.config)})

    def other_shards(self, manifest: Manifest) -> list[str]:
        """Return the paths of files whose bytes differ from the commitment.

        Raises:
            DatasetError: The content of the dataset differs, not only its compression.
        """
        if manifest.fingerprint != self.fingerprint:
            raise DatasetError(
                f"the secret of {self.name} gives another test than the season commits to: their "
                f"fingerprints are {manifest.fingerprint:.16} and {self.fingerprint:.16}"
            )
        found = {shard.path: shard.sha256 for shard in manifest.shards}
        paths = sorted(found.keys() | self.shards.keys())
        return [path for path in paths if found.get(path) != self.shards.get(path)]


def without_seed(config: DatasetConfig) -> dict[str, Any]:
    """Return the options of a dataset, without its seed, as plain types."""
    return {name: value for name, value in config.to_json().items() if name != "seed"}


def seed_of(secret: bytes, config: Mapping[str, Any]) -> int:
    """Return the seed, below 2**64, that follows from a secret and a config without a seed."""
    canonical = json.dumps(config, sort_keys=True, separators=(",", ":"))
    digest = hashlib.sha256(PREFIX + secret + canonical.encode()).digest()
    return int.from_bytes(digest[:8], "big")


@contextmanager
def dataset(workers: int, config: DatasetConfig) -> Iterator[tuple[Path, Manifest]]:
    """Build a dataset in a temporary folder that only this user can read; yield both.

    The seed is not printed.

    Args:
        workers: The number of processes.
        config: The config of the dataset.
    """
    with TemporaryDirectory(prefix="labyrinth-season-") as folder:  # Its mode is 0700.
        job = Job(BuildOptions(workers=workers), config, Path(folder), folder)
        build(job)
        yield Path(folder), Manifest.read(job.folder)
