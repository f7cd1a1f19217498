"""The stage `reveal`: publish the secret, the full results, and submissions not on the Hub."""

from __future__ import annotations

from collections.abc import Mapping

from labyrinth_core.errors import DatasetError
from pipeline.config.stage import Job
from pipeline.machinery.artifact import leave
from pipeline.machinery.console import say
from pipeline.machinery.folders import held
from pipeline.season.commitment import Place, Season
from pipeline.season.files import has_sha256
from pipeline.season.judge import Row, publish, read_rows, settled
from pipeline.season.options import SeasonStageOptions


def run(job: Job[SeasonStageOptions]) -> None:
    """Publish the private files of a season, and its secret last.

    Raises:
        DatasetError: The season does not exist, or results are missing or changed.
    """
    place = Place.of(job)
    season = Season.read(place)
    files = {}
    with held(place.public, place.judged.name):
        secret = season.find_secret(place)
        rows = settled(place, season)
        for number, row in enumerate(rows, 1):
            kept = place.private / f"{number}.json"
            files[f"results/{kept.name}"] = kept.read_bytes()
            for name, digest in row["files"].items() if row["commit"] is None else ():
                kept = place.private / str(number) / name
                if not has_sha256(kept, digest):
                    raise DatasetError(f"{kept} is not the file that {place.judged} names")
                files[f"submissions/{number}/{name}"] = kept.read_bytes()
        if place.revealed.exists():
            _require_unchanged(place, season, rows, files)
        publish(place, season, rows)
        files[place.revealed.name] = f"{secret.hex()}\n".encode()
        leave(place.public, files, overwrite=job.options.overwrite)
    say(f"{place.public} is revealed: publish it, so that anyone can check it with stages=verify.")
    seed = season.dataset_of(secret).seed
    say(f"The dataset has seed={seed} and the options in {place.season}.")


def _require_unchanged(
    place: Place, season: Season, rows: list[Row], files: Mapping[str, bytes]
) -> None:
    """Raise a DatasetError if something was judged or changed after the secret was published."""
    for name, content in files.items():
        public = place.public / name
        if not public.is_file() or public.read_bytes() != content:
            raise DatasetError(
                f"{place.public} is revealed already, with another {name}: nothing can be added"
            )
    if rows != read_rows(place, season):
        raise DatasetError(f"{place.public} is revealed already, with another {place.judged.name}")
