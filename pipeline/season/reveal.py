"""The stage `reveal`: publish the secret, the full results, and submissions not on the Hub."""

from __future__ import annotations

from collections.abc import Mapping

from labyrinth_core.errors import DatasetError
from pipeline.config import Job
from pipeline.machinery import held, leave, say
from pipeline.season.judge import Row, publish, read_rows, settled
from pipeline.season.options import SeasonStageOptions
from pipeline.season.season import Layout, Season, has_sha256


def run(job: Job[SeasonStageOptions]) -> None:
    """Publish the private files of a season, and its secret last.

    Raises:
        DatasetError: The season does not exist, or results are missing or changed.
    """
    layout = Layout.of(job)
    season = Season.read(layout)
    files = {}
    with held(layout.public, layout.judged.name):
        secret = season.find_secret(layout)
        rows = settled(layout, season)
        for number, row in enumerate(rows, 1):
            kept = layout.private / f"{number}.json"
            files[f"results/{kept.name}"] = kept.read_bytes()
            for name, digest in row["files"].items() if row["commit"] is None else ():
                kept = layout.private / str(number) / name
                if not has_sha256(kept, digest):
                    raise DatasetError(f"{kept} is not the file that {layout.judged} names")
                files[f"submissions/{number}/{name}"] = kept.read_bytes()
        if layout.revealed.exists():
            _require_unchanged(layout, season, rows, files)
        publish(layout, season, rows)
        files[layout.revealed.name] = f"{secret.hex()}\n".encode()
        leave(layout.public, files, overwrite=job.options.overwrite)
    say(f"{layout.public} is revealed: publish it, so that anyone can check it with stages=verify.")
    seed = season.dataset_of(secret).seed
    say(f"The dataset has seed={seed} and the options in {layout.season}.")


def _require_unchanged(
    layout: Layout, season: Season, rows: list[Row], files: Mapping[str, bytes]
) -> None:
    """Raise a DatasetError if something was judged or changed after the secret was published."""
    for name, content in files.items():
        public = layout.public / name
        if not public.is_file() or public.read_bytes() != content:
            raise DatasetError(
                f"{layout.public} is revealed already, with another {name}: nothing can be added"
            )
    if rows != read_rows(layout, season):
        raise DatasetError(
            f"{layout.public} is revealed already, with another {layout.judged.name}"
        )
