"""The results that are kept, of runs and of anyone's policies: what does not add up is refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import MANIFEST
from labyrinth_core.data.storage import write_bytes
from labyrinth_core.evaluation.outcomes import KnownDataset
from labyrinth_core.evaluation.results import Results, results_in
from pipeline.config.errors import ConfigError
from pipeline.config.run import Run
from pipeline.studies.results.figures import run_of
from pipeline.studies.results.paper import METHODS

RUNS, SUBMISSIONS = "runs", "submissions"
"""The folders of the files, below that of the tables."""


@dataclass(frozen=True, eq=False)
class Kept:
    """The results in a file that adds up."""

    path: Path
    results: Results
    compared: bool = False
    """Whether the labyrinths and their shortest routes are those of a dataset that is available."""


class AtHand:
    """The dataset that a run names, each config read once when it is first asked for."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._found: dict[str, KnownDataset | None] = {}
        self.missing: dict[str, str] = {}
        """Config that was asked for -> why it is not available."""

    def __call__(self, config: str) -> KnownDataset | None:
        """Return what is known of a config such as `5x5`, None if it is not available.

        Raises:
            ConfigError: A folder is given with a revision.
        """
        if config not in self._found:
            self._found[config] = None
            try:
                self._found[config] = self._read(config)
            except DatasetError as error:
                self.missing[config] = str(error)
            except ValueError as error:
                raise ConfigError(str(error)) from error
        return self._found[config]

    def _read(self, config: str) -> KnownDataset:
        run = self._run
        if run.options.dataset is None and not (run.data_dir / config / MANIFEST).is_file():
            raise DatasetError(f"{run.data_dir / config} holds no dataset")  # Not asking the Hub.
        return KnownDataset.read(run.source, config, run.options.revision)


def read(path: Path, at_hand: AtHand | None = None) -> Kept:
    """Return the results in a file, compared with the dataset if it is available.

    A run on another dataset of the same config is compared with none; any other policy is refused.

    Raises:
        DatasetError: The file cannot be read, or does not add up; the message has one line.
    """
    results = Results.load(path)
    known = None if at_hand is None else at_hand(results.config)
    if at_hand is None or known is None:
        return Kept(path, results)
    if results.run is not None and results.fingerprint != known.fingerprint:
        at_hand.missing[results.config] = f"{known.place} is another dataset"
        return Kept(path, results)
    try:
        results.compare_with(known)
    except ValueError as error:
        raise DatasetError(f"{path} is refused: {error}") from error
    return Kept(path, results, compared=True)


def gather(run_dir: Path, results_dir: Path, at_hand: AtHand) -> list[str]:
    """Copy the results in a folder of runs to where they are kept; return which are refused.

    What was kept before of one that is refused stays.
    """
    refused = []
    for path in results_in(run_dir):
        try:
            results = read(path, at_hand).results
        except DatasetError as error:
            refused.append(str(error))
            continue
        kind = SUBMISSIONS if results.run is None else RUNS
        target = results_dir / kind / path.parts[-3] / f"{path.parts[-2]}.json"
        target.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(target, path.read_bytes())
    return refused


def read_all(results_dir: Path, at_hand: AtHand) -> tuple[list[Kept], list[Kept], list[str]]:
    """Return the runs and the submissions that are kept and add up, and which are refused."""
    runs: list[Kept] = []
    submissions: dict[tuple[str, str, str], Kept] = {}
    refused = []
    for path in _files(results_dir):
        try:
            each = read(path, at_hand)
            results, name = each.results, each.results.method.name if each.results.method else ""
            if path.is_relative_to(results_dir / RUNS):
                if results.run is None:
                    raise DatasetError(f"{path} is refused: it is not of a run that was trained")
                runs.append(each)
                continue
            other = submissions.setdefault((results.config, results.fingerprint, name), each)
            if other is not each:
                raise DatasetError(
                    f"{path} is refused: {other.path} has the same name, {name}, on the same "
                    "dataset"
                )
        except DatasetError as error:
            refused.append(str(error))
    return runs, list(submissions.values()), refused


def _files(results_dir: Path) -> list[Path]:
    submitted = sorted((results_dir / SUBMISSIONS).rglob("*.json"))
    return sorted((results_dir / RUNS).glob("*/*.json")) + submitted


def read_runs(results_dir: Path) -> list[Results]:
    """Return the results of the runs that are kept, by config, setup, method and seed.

    Raises:
        DatasetError: A file is refused, or two runs cannot be compared.
    """
    found = [read(path) for path in sorted((results_dir / RUNS).glob("*/*.json"))]
    return [each.results for each in comparable(found)]


def comparable(runs: Sequence[Kept]) -> list[Kept]:
    """Return runs by config, setup, method and seed.

    Raises:
        DatasetError: Two runs on the same config are of different datasets, or two seeds of one
            method have different settings.
    """
    first: dict[object, Kept] = {}
    for each in runs:
        results, run = each.results, run_of(each.results)
        other = first.setdefault(results.config, each)
        if _differ(other.results, results):
            raise DatasetError(
                f"{each.path} and {other.path} are of different datasets, and not to be compared: "
                "remove one, or choose another results_dir"
            )
        other = first.setdefault((results.config, run.of_all_seeds), each)
        mine, others = run.settings, run_of(other.results).settings
        # Settings that only one of them has are newer, and have no effect by default.
        common = [name for name in mine if name in others and mine[name] != others[name]]
        if common:
            differing = ", ".join(f"{name}={mine[name]} and {others[name]}" for name in common)
            raise DatasetError(
                f"{each.path} and {other.path} are of different settings, {differing}, and not to "
                "be averaged: remove one, or choose another results_dir"
            )

    def order(each: Kept) -> tuple[Any, ...]:
        run = run_of(each.results)
        place = [*METHODS, run.method].index(run.method)
        return each.results.config, run.setup, place, run.method, run.seed

    return sorted(runs, key=order)


def _differ(one: Results, other: Results) -> bool:
    """Return whether two runs learnt from, or were judged on, different labyrinths.

    One that learnt from some labyrinths of train is judged on the first ones alone.
    """
    if (one.fingerprint, run_of(one).fingerprint) != (other.fingerprint, run_of(other).fingerprint):
        return True
    for split in one.splits.keys() & other.splits.keys():
        scores = one.splits[split], other.splits[split]
        shared = min(len(each.distance) for each in scores)
        for name in ("labyrinth_ids", "distance"):
            first, second = (getattr(each, name)[:shared].tolist() for each in scores)
            if first != second:
                return True
    return False
