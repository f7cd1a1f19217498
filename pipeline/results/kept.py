"""Collect and check the results of runs and of submitted policies; refuse inconsistent files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labyrinth_core.errors import DatasetError, printable_line
from labyrinth_core.evaluation import Description, Results, TrainedRun
from pipeline.config import ResultFolderOptions
from pipeline.machinery import Ownership, Sums
from pipeline.results.checking import Checks
from pipeline.results.paper import METHODS, title_of

AUTHOR = "Labyrinth datasets"
"""The author of runs of the stages `train` and `evaluate`."""

RUNS = "runs"
"""The subfolder with the results of runs; those of other policies are in `SUBMISSIONS`."""


def run_of(results: Results) -> TrainedRun:
    """Return the run that trained the evaluated policy; the results have to be of a run."""
    assert results.run is not None  # Results of other policies are kept separately.
    return results.run


Copies = Mapping[str, tuple[Path, Results]]
"""Name in `results_dir` -> the file in `run_dir` to copy there, and its results."""


def gather(checks: Checks, results_dir: Path, overwrite: bool) -> tuple[Copies, list[str]]:
    """Return the results of runs that are to be copied, and why each other file is refused.

    Nothing is copied yet. If a file is refused, its earlier copy stays. With `overwrite`, copies
    replace files that were made or changed by someone else.

    Raises:
        DatasetError: The SHA256SUMS of `results_dir` is damaged, or another program's.
    """
    refused, copies = [], {}
    for path in Results.files_of_runs(checks.run_dir):
        config, name = path.parts[-3:-1]
        try:
            results = checks.read(path, (config, name))
        except DatasetError as error:
            refused.append(str(error))
            continue
        kind = ResultFolderOptions.SUBMISSIONS if results.run is None else RUNS
        copies[f"{kind}/{config}/{name}.json"] = path, results
    files = {name: path.read_bytes() for name, (path, _) in copies.items()}
    own = Ownership(Sums.read(results_dir, overwrite=overwrite))
    for name in () if overwrite else own.others(files):
        refused.append(
            f"{copies[name][0]} is not copied: {results_dir / name} was made or changed by someone "
            "else; move it away, or give overwrite=true"
        )
        del copies[name]
    return copies, refused


def read_all(
    checks: Checks, results_dir: Path, copies: Copies
) -> tuple[dict[Path, Results], list[Results], list[str]]:
    """Read all results in `results_dir`, as if `copies` were there already.

    Returns:
        The runs by file, the submissions, and why each other file is refused.
    """
    runs: dict[Path, Results] = {}
    submissions: list[Results] = []
    named: dict[tuple[str, str, str], str] = {}
    new = {results_dir / name: results for name, (_, results) in copies.items()}
    of_runs = (results_dir / RUNS).glob("[!.]*/[!.]*.json")
    submitted = Results.submitted_files(results_dir / ResultFolderOptions.SUBMISSIONS)
    refused = [f"{path} is refused: {reason}" for path, reason in submitted if reason]
    files = (path for path, reason in submitted if not reason)
    for path in sorted({*new, *of_runs, *files}):
        is_run = path.is_relative_to(results_dir / RUNS)
        run_named = (path.parent.name, path.stem) if is_run else None
        try:
            each = new[path] if path in new else checks.read(path, run_named)
            if not is_run:
                _require_own_name(path, each, named)
                submissions.append(each)
            elif each.run is None:
                raise DatasetError(f"{path} is refused: it has no results of a training run")
            else:
                runs[path] = each
        except DatasetError as error:
            refused.append(str(error))
            continue
        for name in _names(each):
            key = each.config, each.fingerprint, Description.as_compared(name)
            named.setdefault(key, f"{path} has the same name, {name}, on the same dataset")
    return runs, submissions, refused


def _names(results: Results) -> list[str]:
    """Return every name of a policy in tables and files."""
    run = results.run
    if run is not None:
        return [title_of(run), run.of_all_seeds, run.name]
    return [results.about.name]


def _require_own_name(
    path: Path, results: Results, named: Mapping[tuple[str, str, str], str]
) -> None:
    """Raise a DatasetError if a submission has the name of a run or of another submission."""
    if results.run is not None:
        raise DatasetError(f"{path} is refused: results of a training run belong below {RUNS}")
    if Description.as_compared(results.about.author) == Description.as_compared(AUTHOR):
        raise DatasetError(f"{path} is refused: author={AUTHOR} is reserved for runs")
    name = Description.as_compared(results.about.name)
    reason = named.get((results.config, results.fingerprint, name))
    if name in {Description.as_compared(each) for method in METHODS.items() for each in method}:
        reason = f"name={results.about.name} is reserved for runs"
    if reason is not None:
        raise DatasetError(f"{path} is refused: {reason}")


def of_equal_weights(runs: Mapping[Path, Results]) -> list[list[Path]]:
    """Return each group of runs with the same weights, which are one policy under several names."""
    groups: dict[str, list[Path]] = {}
    for path, results in runs.items():
        if weights := run_of(results).evaluated["weights"]:
            groups.setdefault(weights, []).append(path)
    return [paths for paths in groups.values() if len(paths) > 1]


def comparable(runs: Mapping[Path, Results]) -> list[Results]:
    """Check that runs can be compared, and sort them by config, setup, method and seed.

    Args:
        runs: The runs by their files.

    Raises:
        DatasetError: Two runs on the same config are of different datasets, or two seeds of one
            method have different settings.
    """
    first: dict[object, Path] = {}
    for path, results in runs.items():
        run = run_of(results)
        other = first.setdefault(results.config, path)
        fingerprints = {
            (each.fingerprint, run_of(each).fingerprint) for each in (runs[other], results)
        }
        if len(fingerprints) > 1:
            raise DatasetError(
                f"{path} and {other} are of different datasets, so they cannot be compared: "
                "remove one, or choose another results_dir"
            )
        other = first.setdefault((results.config, run.of_all_seeds), path)
        mine, others = run.settings, run_of(runs[other]).settings
        # A setting that only one of them has is newer, and has no effect by default.
        common = [name for name in mine if name in others and mine[name] != others[name]]
        if common:
            pairs = (f"{name}={mine[name]} and {others[name]}" for name in common)
            differing = printable_line(", ".join(pairs))
            raise DatasetError(
                f"{path} and {other} have different settings, {differing}, so they cannot "
                "be averaged: remove one, or choose another results_dir"
            )

    def order(results: Results) -> tuple[Any, ...]:
        run = run_of(results)
        number = [*METHODS, run.method].index(run.method)
        return results.config, run.setup, number, run.method, run.seed

    return sorted(runs.values(), key=order)
