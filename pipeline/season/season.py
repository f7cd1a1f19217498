"""The stage `season`: draw a secret, and publish a commitment to the test that follows from it."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import (
    File,
    LocalFile,
)
from pipeline.config import ConfigError, Job, check
from pipeline.machinery import held, produced, say
from pipeline.season.commitment import (
    LEAST,
    SECRET_BYTES,
    Layout,
    Season,
    check_rows,
    dataset,
    seed_of,
    without_seed,
)
from pipeline.season.options import SeasonStageOptions


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
