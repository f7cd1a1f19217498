"""The stage `verify`: rebuild the test of a revealed season, and judge each submission again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from labyrinth_core.data import DatasetConfig, Manifest
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.evaluation import KnownDataset, PolicyError, Results
from pipeline.config import Job
from pipeline.machinery import Sums, say, table
from pipeline.season.judge import Row, check_row, fetched, judged, read_list, shown, versions
from pipeline.season.options import SeasonStageOptions
from pipeline.season.season import Layout, Season, dataset, has_sha256

EQUAL = "yes"
"""Shown for a submission whose results are reproduced to the last bit."""


def run(job: Job[SeasonStageOptions]) -> None:
    """Verify a season from its published files, and print all differences.

    Raises:
        DatasetError: The season does not exist, is not revealed, or cannot be confirmed.
    """
    layout = Layout.of(job)
    season = Season.read(layout)
    if not layout.revealed.exists():
        raise DatasetError(f"{layout.public} is not revealed: {layout.revealed.name} is missing")
    secret = season.require_secret(layout.revealed)
    entries = read_list(layout, season)
    config = season.dataset_of(secret)
    with dataset(job.options.workers, config) as data:
        wrong = _other_files(layout, season, season.other_shards(data.manifest))
        known = KnownDataset(data)
        lines = []
        for number, entry in enumerate(entries, 1):
            if reason := _refused(entry, entries[: number - 1]):
                lines.append([f"entry {number}", "-", "-", f"no: {reason}"])
                continue
            figures, equal = _judged_again(layout, season, number, entry, known)
            lines.append([entry["submission"], shown(entry["figures"]["test"]), figures, equal])
        lines += [[name, "-", "-", "no: not in the list"] for name in _unlisted(layout, entries)]
        wrong += sum(line[-1] != EQUAL for line in lines)
        cells = [[cell.replace("|", r"\|") for cell in line] for line in lines]
        say(table(["submission", "judged", "recomputed", "equal"], cells, "llll"))
        for path in sorted((layout.public / "self-reported").glob("[!.]*.json")):
            wrong += _self_reported(path, known)
    if wrong:
        raise DatasetError(f"{layout.public}: {wrong} of its claims cannot be confirmed")


def _refused(entry: Any, before: list[Any]) -> str | None:
    """Return why an entry cannot be one of a judge; None if it can."""
    try:
        check_row(entry)
    except ValueError as error:
        return one_line(error)
    about = {name: entry[name] for name in ("submission", "commit", "files")}
    twice = any(isinstance(each, dict) and each | about == each for each in before)
    return "it is in the list twice" if twice else None


def _unlisted(layout: Layout, entries: list[Any]) -> list[str]:
    """Return the names of results and submissions that belong to no entry."""
    numbers = [str(number) for number in range(1, len(entries) + 1)]
    listed = {*(f"results/{number}.json" for number in numbers)}
    listed |= {f"submissions/{number}" for number in numbers}
    paths = [*(layout.public / "results").glob("[!.]*.json")]
    paths += (layout.public / "submissions").glob("[!.]*")
    names = (path.relative_to(layout.public).as_posix() for path in paths)
    return sorted(name for name in names if name not in listed)


def _other_files(layout: Layout, season: Season, paths: list[str]) -> int:
    """Compare the commitment with its list and with the test; return the number of differences."""
    say(f"{season.name}: the secret and the content of the test match the commitment.")
    changed = not Sums.read(layout.public).has(layout.season.name)
    if changed:  # Nothing else shows a change of the date.
        say(
            f"{layout.season} is not the file that {Sums.FILE} lists, so its date is not confirmed."
        )
    if not paths:
        say(f"All {len(season.shards)} files of the test are identical.")
        return int(changed)
    then = season.versions
    unlike = [
        f"{name} {then[name]}, here {here}"
        for name, here in Manifest.current_versions().items()
        if name in then and then[name] != here
    ]
    why = f"as written by {'; '.join(unlike)}" if unlike else "although the versions are equal"
    say(f"{len(paths)} of {len(season.shards)} files have other bytes for this content, {why}.")
    return changed + (not unlike)


def _judged_again(
    layout: Layout, season: Season, number: int, row: Row, known: KnownDataset
) -> tuple[str, str]:
    """Judge a submission again; return its figures, and `EQUAL` or the difference."""
    revealed = layout.public / "results" / f"{number}.json"
    folder = None if row["commit"] else layout.public / "submissions" / str(number)
    try:
        committed = has_sha256(revealed, row["results_sha256"])
        receipt = Results.load(revealed).memorised if committed else None
        train = None if receipt is None else DatasetConfig.from_json(receipt.train)
        with fetched(row["submission"], folder, pinned=row) as submission:
            again = judged(season, submission, known.data, row["versions"], train)
            here = versions(submission.library)
        figures = shown(again.row["figures"]["test"])
        if not committed:
            return figures, f"no: results/{revealed.name} does not match the commitment"
        if again.row == row:
            return figures, EQUAL
        if again.row["results_sha256"] == row["results_sha256"]:
            return figures, f"no: {layout.judged.name} contradicts the results"
        told = Results.load(revealed, lambda _: known).splits
    except (DatasetError, PolicyError, OSError) as error:
        return "-", f"no: {one_line(error)}"
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
    except (DatasetError, ValueError) as error:
        say(f"self-reported, and refused: {one_line(error)}")
        return True
    test, name = results.splits["test"], results.about.name
    say(f"self-reported, not verified: {name!r}, {shown({'spl': test.spl, 'sr': test.sr})}")
    return False
