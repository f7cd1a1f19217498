"""The stage `season`: draw a secret, and commit to the test that follows from it.

The commitment has hashes that are published before anyone sees the test. The secret has 256 random
bits. The seed of the dataset is the first eight bytes, most significant first, of the SHA-256 of
`PREFIX`, the secret, and the config as JSON without its seed, with sorted keys and no spaces. The
dataset is not stored: it can be rebuilt from the secret.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import gettempdir
from typing import Annotated, Any, Literal
from uuid import uuid4

from labyrinth_core import typed
from labyrinth_core.data import Dataset, DatasetConfig, Manifest
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.evaluation import Results
from labyrinth_core.storage import File, LocalFile
from pipeline.config import ConfigError, Job, check
from pipeline.generation import built
from pipeline.machinery import held, produced, say
from pipeline.season.options import SeasonStageOptions

PRIVATE = "labyrinth-season-"
"""How the names of temporary folders begin."""

PREFIX = b"labyrinth season, seed, version 1\n"
SECRET_BYTES = 32

LEAST = 16
"""The minimum number of labyrinths: fewer could be guessed and checked against published hashes.
16 of the 192 or more structures of a size can be ordered in more ways than there are seeds."""

MOST_ROWS = 10**9
"""The maximum number of rows that a season may need: a stranger's season must not fill the disk of
those who verify it. A thousand labyrinths of 5x5 may need half a million."""

MOST_BYTES = 1 << 24
"""The size limit of `season.json` and `judged.json`, in bytes."""


@dataclass(frozen=True)
class Layout:
    """The paths of a season's files."""

    public: Path
    """The folder that is published."""

    @classmethod
    def of(cls, job: Job[SeasonStageOptions]) -> Layout:
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

    kind: Literal["labyrinth-season"] = "labyrinth-season"
    format: Literal[1] = 1
    name: Annotated[str, typed.Like("[a-z0-9][a-z0-9-]{0,50}")]
    date: Annotated[str, typed.Like(r"\d{4}-\d\d-\d\d")]
    config: Mapping[typed.Word, Any]
    """The options of the dataset, without its seed."""
    labyrinths: Mapping[typed.Word, typed.Count]
    """Split -> number of labyrinths."""
    secret_sha256: typed.Sha256
    fingerprint: typed.Sha256
    """The fingerprint of the dataset's values and pixels, which does not depend on compression."""
    shards: Mapping[typed.Word, typed.Sha256]
    """Path -> SHA-256 of the file; other library versions may compress differently."""
    versions: Mapping[typed.Word, typed.Version]
    """The library versions that wrote the shards."""

    @classmethod
    def of(cls, name: str, date: str, secret: bytes, manifest: Manifest) -> Season:
        """Return the commitment to a secret and its dataset."""
        return cls(
            name=name,
            date=date,
            config=without_seed(manifest.config),
            labyrinths=labyrinths_of(manifest),
            secret_sha256=hashlib.sha256(secret).hexdigest(),
            fingerprint=manifest.fingerprint,
            shards={shard.path: shard.sha256 for shard in manifest.shards},
            versions=Manifest.current_versions(),
        )

    @classmethod
    def read(cls, layout: Layout) -> Season:
        """Read the season in a folder; raise a DatasetError if there is no valid season."""
        try:
            require_regular(layout.season, MOST_BYTES)
            season: Season = typed.read_as(cls, File(layout.season).read_json())
            if not typed.is_day(season.date):
                raise ValueError(f"date={season.date}: there is no such day")
            config = season.dataset_of(b"")
            if season.config != without_seed(config):
                raise ValueError("its config has a seed, or options at their defaults")
            check_rows(config)
        except FileNotFoundError as error:
            raise DatasetError(
                f"{layout.public} is not a season: no {layout.season.name}"
            ) from error
        except (OSError, ValueError, RecursionError) as error:
            raise DatasetError(f"{layout.season} is invalid: {one_line(error):.300}") from error
        if season.name != layout.public.name:
            raise DatasetError(f"{layout.season} is of the season {season.name}")
        return season

    def to_text(self) -> str:
        """Return the content of `season.json`."""
        return json.dumps(asdict(self), indent=2) + "\n"

    def find_secret(self, layout: Layout) -> bytes:
        """Return the secret before the reveal; raise a DatasetError if there is none.

        It is moved to its place if the process that made the season was killed before.
        """
        for kept in LocalFile.temporaries(layout.secret.parent, [layout.secret.name]):
            with suppress(DatasetError, OSError):
                self.require_secret(kept)
                kept.replace(layout.secret)
        return self.require_secret(layout.secret)

    def require_secret(self, path: Path) -> bytes:
        """Read the secret from a file; raise a DatasetError if it is not the one committed to."""
        try:
            require_regular(path, MOST_BYTES)
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
        shards = {shard.path: shard.sha256 for shard in manifest.shards}
        for what, named, right in (
            ("labyrinths", self.labyrinths, labyrinths_of(manifest)),
            ("shards", dict.fromkeys(self.shards, 1), dict.fromkeys(shards, 1)),
        ):
            if differing := named.items() ^ right.items():
                raise DatasetError(
                    f"season.json of {self.name} has other {what} than the test: "
                    f"{min(differing)[0]:.60}"
                )
        return [path for path in sorted(shards) if shards[path] != self.shards[path]]


def labyrinths_of(manifest: Manifest) -> dict[str, int]:
    """Return the number of labyrinths in each split."""
    counts = Counter[str]()
    for shard in manifest.shards:
        counts[shard.split] += shard.labyrinths
    return dict(counts)


def check_rows(config: DatasetConfig) -> None:
    """Raise ValueError if a dataset might need more than `MOST_ROWS` rows."""
    routes = 1 if config.solutions == "shortest" else config.solutions_limit
    states = config.height * config.width * config.task.rules.phases
    rows = config.labyrinths * (len(config.splits) * routes * states + config.random_steps)
    if rows > MOST_ROWS:
        raise ValueError(
            f"{config.given('labyrinths')}: up to {rows:,} rows, more than the {MOST_ROWS:,} of a "
            "season: give fewer, a smaller size, or lower limits of solutions and random_steps"
        )


def without_seed(config: DatasetConfig) -> dict[str, Any]:
    """Return the options of a dataset, without its seed, as plain types."""
    return {name: value for name, value in config.to_json().items() if name != "seed"}


def seed_of(secret: bytes, config: Mapping[str, Any]) -> int:
    """Return the seed, below 2**64, that follows from a secret and a config without a seed."""
    canonical = json.dumps(config, sort_keys=True, separators=(",", ":"))
    digest = hashlib.sha256(PREFIX + secret + canonical.encode()).digest()
    return int.from_bytes(digest[:8], "big")


@contextmanager
def dataset(workers: int, config: DatasetConfig) -> Iterator[Dataset]:
    """Build a dataset in a temporary folder that only this user can read, and yield it.

    The seed is not printed.

    Args:
        workers: The number of processes.
        config: The config of the dataset.
    """
    with private_folder() as folder:
        yield built(config, folder, workers)


# Files of strangers, read with limits, and folders that only this user can read.


def require_regular(path: Path, most: int) -> None:
    """Check a file before it is read.

    Args:
        path: The file, or a link to it.
        most: The maximum number of bytes.

    Raises:
        DatasetError: It is too large, or a device, a pipe or a folder.
        OSError: It does not exist.
    """
    size = path.stat().st_size
    if not path.is_file():
        raise DatasetError(f"{path} is not a regular file")
    if size > most:
        raise DatasetError(f"{path} has {size:,} bytes, more than {most:,}")


def has_sha256(path: Path, digest: str) -> bool:
    """Return whether a file exists, is not larger than any results or weights, and has a hash."""
    return (
        path.is_file() and path.stat().st_size <= Results.LARGEST and File(path).sha256() == digest
    )


@contextmanager
def private_folder() -> Iterator[Path]:
    """Yield a new temporary folder that only this user can read, and remove it at the end.

    Folders that killed processes of this user left are removed, too. A process holds the lock of
    its folder until it ends, however it ends.
    """
    base = Path(gettempdir())
    own = base / f"{PRIVATE}{uuid4().hex}"
    with held(base, own.name):
        own.mkdir(mode=0o700)
        try:
            for lock in base.glob(f".{PRIVATE}*.lock"):
                abandoned = base / lock.name.removeprefix(".").removesuffix(".lock")
                with suppress(OSError):  # Its process is alive and holds it, or has just ended.
                    if abandoned != own and lock.lstat().st_uid == own.lstat().st_uid:
                        with LocalFile(lock).locked(wait=False):
                            File(abandoned).remove()
            yield own
        finally:
            File(own).remove()


def run(job: Job[SeasonStageOptions]) -> None:
    """Start a season: write its secret, and publish the commitment.

    The secret moves to its place after the commitment has done so, from a temporary file beside
    it: whenever the process is killed, the same command goes on.

    Raises:
        ConfigError: There are too few labyrinths, or too many.
        DatasetError: Another season or a secret of this name exists already.
    """
    layout, options = Layout.of(job), job.options.season
    count = job.dataset.labyrinths
    check(count >= LEAST, f"labyrinths={count}: give {LEAST} or more, since fewer can be guessed")
    try:
        check_rows(job.dataset)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    existed, kept = layout.public.exists(), LocalFile(layout.secret).temporary()
    try:
        if not existed:
            with produced(layout.public, {"season": options.name}) as made:
                if made is not None:
                    _make(job, layout, made, kept)
    except BaseException:
        if not layout.public.exists():
            kept.unlink(missing_ok=True)
        raise
    with held(layout.public.parent, layout.public.name):
        season = Season.read(layout)
        same = (season.date, season.config) == (options.date, without_seed(job.dataset))
        if not same or layout.revealed.exists():
            raise DatasetError(f"{layout.public} exists: choose another season.name")
        season.find_secret(layout)
    say(
        f"{layout.season}{' exists already' if existed else ''}: publish this folder now. "
        f"{layout.secret} holds the secret: keep it, and show it to no one until stages=reveal "
        "publishes it."
    )


def _make(job: Job[SeasonStageOptions], layout: Layout, folder: Path, kept: Path) -> None:
    """Write a season into a folder, and its secret into the temporary file `kept`."""
    if layout.secret.exists():
        raise DatasetError(
            f"{layout.secret} exists, but its season does not: move it away, or choose another "
            "season.name"
        )
    # A process was killed before the season existed.
    for left in LocalFile.temporaries(layout.secret.parent, [layout.secret.name]):
        left.unlink()
    secret = os.urandom(SECRET_BYTES)
    _keep(kept, layout.secret, secret)
    seed = seed_of(secret, without_seed(job.dataset))
    with dataset(job.options.workers, replace(job.dataset, seed=seed)) as data:
        season = Season.of(layout.public.name, job.options.season.date, secret, data.manifest)
    File(folder / layout.season.name).write_text(season.to_text())
    job.write_config(folder)


def _keep(path: Path, named: Path, secret: bytes) -> None:
    """Write a secret into a new file that only its owner can read; errors name its later layout."""
    with LocalFile(named).naming(path):
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(secret.hex() + "\n")
            file.flush()
            os.fsync(file.fileno())
