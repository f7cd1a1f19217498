"""The stage `season`: draw a secret, and publish a commitment to the test that follows from it."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.storage import naming, write_text
from pipeline.config.errors import check
from pipeline.config.stage import CONFIG, Job
from pipeline.machinery.artifact import produced
from pipeline.machinery.console import say
from pipeline.season.commitment import (
    LEAST,
    SECRET_BYTES,
    Place,
    Season,
    dataset,
    seed_of,
    without_seed,
)
from pipeline.season.options import SeasonStageOptions


def run(job: Job[SeasonStageOptions]) -> None:
    """Start a season: write its secret, and publish the commitment.

    Raises:
        ConfigError: There are too few labyrinths.
        DatasetError: A season or a secret of this name exists already.
    """
    place, options = Place.of(job), job.options.season
    count = job.dataset.labyrinths
    check(count >= LEAST, f"labyrinths={count}: give {LEAST} or more, since fewer can be guessed")
    exists = DatasetError(f"{place.public} exists: choose another season.name")
    if place.public.exists():
        raise exists
    secret, is_kept = os.urandom(SECRET_BYTES), False
    try:
        with produced(place.public, {"season": options.name}) as made:
            if made is None:  # Another process made it while this one waited.
                raise exists
            _keep(place.secret, secret)
            is_kept = True
            seed = seed_of(secret, without_seed(job.dataset))
            with dataset(job.options.workers, replace(job.dataset, seed=seed)) as (_, manifest):
                season = Season.of(options.name, options.date, secret, manifest)
            write_text(made / place.season.name, season.to_text())
            if job.composed:
                write_text(made / CONFIG, job.composed)
    except BaseException:
        if is_kept and not place.season.exists():
            place.secret.unlink()
        raise
    say(
        f"{place.season}: publish this folder now. {place.secret} holds the secret: keep it, and "
        "show it to no one until stages=reveal publishes it."
    )


def _keep(path: Path, secret: bytes) -> None:
    """Write a secret into a new file that only its owner can read."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError as error:
        raise DatasetError(
            f"{path} exists, but its season does not: move it away, or choose another season.name"
        ) from error
    try:
        with naming(path), os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(secret.hex() + "\n")
            file.flush()
            os.fsync(file.fileno())
    except BaseException:
        path.unlink()
        raise
