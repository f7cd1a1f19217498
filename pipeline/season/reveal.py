"""The stage `reveal`: publish the secret, the full results, and submissions not on the Hub."""

from __future__ import annotations

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.storage import file_sha256
from pipeline.config.stage import Job
from pipeline.machinery.artifact import leave
from pipeline.machinery.console import say
from pipeline.machinery.folders import held
from pipeline.season.commitment import Place, Season
from pipeline.season.judge import read_rows
from pipeline.season.options import SeasonStageOptions


def run(job: Job[SeasonStageOptions]) -> None:
    """Publish the private files of a season, and its secret last.

    Raises:
        DatasetError: The season does not exist, or results are missing or changed.
    """
    place = Place.of(job)
    season = Season.read(place)
    secret = season.require_secret(place.secret)
    files = {}
    with held(place.public, place.judged.name):
        for number, row in enumerate(read_rows(place), 1):
            kept = place.private / f"{number}.json"
            if not kept.is_file() or file_sha256(kept) != row["results_sha256"]:
                raise DatasetError(f"{kept} does not hold the results that {place.judged} names")
            files[f"results/{kept.name}"] = kept.read_bytes()
            for name, digest in row["files"].items() if row["commit"] is None else ():
                kept = place.private / str(number) / name
                if not kept.is_file() or file_sha256(kept) != digest:
                    raise DatasetError(f"{kept} is not the file that {place.judged} names")
                files[f"submissions/{number}/{name}"] = kept.read_bytes()
        files[place.revealed.name] = f"{secret.hex()}\n".encode()
        leave(place.public, files)
    say(f"{place.public} is revealed: publish it, so that anyone can check it with stages=verify.")
    seed = season.dataset_of(secret).seed
    say(f"The dataset has seed={seed} and the options in {place.season}.")
