"""The stage `verify`: rebuild the test of a revealed season, and judge each submission again."""

from __future__ import annotations

from pathlib import Path

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.storage import file_sha256
from labyrinth_core.evaluation.answers import PolicyError
from labyrinth_core.evaluation.known import KnownDataset
from labyrinth_core.evaluation.results import Results
from pipeline.config.stage import Job
from pipeline.machinery.console import say
from pipeline.machinery.dataset import build_versions
from pipeline.machinery.markdown import table
from pipeline.season.commitment import Place, Season, dataset
from pipeline.season.judge import Row, judged, read_rows, shown
from pipeline.season.options import SeasonStageOptions
from pipeline.season.submission import fetched, versions

EQUAL = "yes"
"""Shown for a submission whose results are reproduced to the last bit."""


def run(job: Job[SeasonStageOptions]) -> None:
    """Verify a season from its published files, and print all differences.

    Raises:
        DatasetError: The season does not exist, is not revealed, or cannot be confirmed.
    """
    place = Place.of(job)
    season = Season.read(place)
    if not place.revealed.exists():
        raise DatasetError(f"{place.public} is not revealed: {place.revealed.name} is missing")
    secret = season.require_secret(place.revealed)
    config = season.dataset_of(secret)
    with dataset(job.options.workers, config) as (data_dir, manifest):
        wrong = _other_files(season, season.other_shards(manifest))
        known = KnownDataset.read(str(data_dir), config.name)
        lines = []
        for number, row in enumerate(read_rows(place), 1):
            figures, equal = _judged_again(place, season, number, row, known)
            lines.append([row["submission"], shown(row["figures"]["test"]), figures, equal])
            wrong += equal != EQUAL
        say(table(["submission", "judged", "recomputed", "equal"], lines, "llll"))
        for path in sorted((place.public / "self-reported").glob("[!.]*.json")):
            wrong += _self_reported(path, known)
    if wrong:
        raise DatasetError(f"{place.public}: {wrong} of its claims cannot be confirmed")


def _other_files(season: Season, paths: list[str]) -> int:
    """Compare the files of the test with the commitment; return 1 for an unexplained difference."""
    say(f"{season.name}: the secret and the content of the test match the commitment.")
    if not paths:
        say(f"All {len(season.shards)} files of the test are identical.")
        return 0
    then = season.versions
    unlike = [
        f"{name} {then.get(name)}, here {here}"
        for name, here in build_versions().items()
        if then.get(name) != here
    ]
    why = f"as written by {'; '.join(unlike)}" if unlike else "although the versions are equal"
    say(f"{len(paths)} of {len(season.shards)} files have other bytes for this content, {why}.")
    return int(not unlike)


def _judged_again(
    place: Place, season: Season, number: int, row: Row, known: KnownDataset
) -> tuple[str, str]:
    """Judge a submission again; return its figures, and `EQUAL` or the difference."""
    revealed = place.public / "results" / f"{number}.json"
    folder = None if row["commit"] else place.public / "submissions" / str(number)
    try:
        with fetched(row["submission"], folder, pinned=row) as submission:
            data_dir, config = Path(known.source), known.manifest.config
            again = judged(season, submission, data_dir, config, signed=row["versions"])
            here = versions(submission.library)
        figures = shown(again.row["figures"]["test"])
        if not revealed.is_file() or file_sha256(revealed) != row["results_sha256"]:
            return figures, f"no: results/{revealed.name} does not match the commitment"
        if again.row == row:
            return figures, EQUAL
        if again.row["results_sha256"] == row["results_sha256"]:
            return figures, f"no: {place.judged.name} contradicts the results"
        told = Results.load(revealed, lambda _: known).splits
    except (DatasetError, PolicyError) as error:
        return "-", f"no: {error}"
    splits = again.results.splits
    pairs = ((told[name].episodes, splits[name].episodes) for name in told.keys() & splits.keys())
    unlike = sum(int((one.moves != other.moves).sum()) for one, other in pairs)
    unlike_versions = [f"{name} {row['versions'][name]}, here {here[name]}" for name in here]
    return figures, f"no: {unlike} episodes differ ({'; '.join(unlike_versions)})"


def _self_reported(path: Path, known: KnownDataset) -> bool:
    """Print self-reported results, which no judge has verified; return whether they are refused."""
    try:
        results = Results.load(path, lambda _: known)
        results.require_dataset(known)
        if "test" not in results.splits:
            raise ValueError(f"{path} has no results on test")
    except ValueError as error:
        say(f"self-reported, and refused: {error}")
        return True
    test, name = results.splits["test"], results.method.name if results.method else path.name
    say(f"self-reported, not verified: {name}, {shown({'spl': test.spl, 'sr': test.sr})}")
    return False
