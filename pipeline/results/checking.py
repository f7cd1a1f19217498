"""Collect the results of runs and of submitted policies, and refuse inconsistent files.

Results are checked against their dataset and, if that is asked, their policy: those of runs and
those that `open_policy` opens are played again. No code is executed that a file names: a policy in
Python, and a run of a method in Python, rests on the word of whoever made the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import Dataset, Manifest
from labyrinth_core.errors import DatasetError, printable_line
from labyrinth_core.evaluation import Description, Evaluation, KnownDataset, Results, TrainedRun
from labyrinth_core.policies import PolicyNameError, open_policy
from labyrinth_core.storage import folder_at
from pipeline.config import Job, ResultFolderOptions, TrainingOptions, check
from pipeline.machinery import Ownership, Sums, say
from pipeline.results.leaderboard import AUTHOR, IN_PRINT, run_of, title_of
from pipeline.results.options import ResultsOptions

RUNS = "runs"
"""The subfolder with the results of runs; those of other policies are in `SUBMISSIONS`."""


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
        run, names = each.run, [each.about.name]
        if run is not None:  # Every name of a run in tables and files.
            names = [title_of(run), run.of_all_seeds, run.name]
        for name in names:
            key = each.config, each.fingerprint, Description.as_compared(name)
            named.setdefault(key, f"{path} has the same name, {name}, on the same dataset")
    return runs, submissions, refused


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
    if name in {Description.as_compared(each) for method in IN_PRINT.items() for each in method}:
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
        number = [*IN_PRINT, run.method].index(run.method)
        return results.config, run.setup, number, run.method, run.seed

    return sorted(runs.values(), key=order)


_OF_RUN = (
    *("method", "encoder", "protocol", "train_labyrinths", "seed", "settings", "config"),
    *("fingerprint", "training"),
)


CLOSE = 1e-4
"""Scores of two actions that differ by at most this share of the greatest may fall another way on
another machine, which sums in another order; float32 has seven digits."""


class Checks:
    """Reads results, and checks them against the dataset and the policies that a job names."""

    def __init__(self, job: Job[ResultsOptions]) -> None:
        """Prepare to read each config of the dataset when it is first needed.

        Raises:
            ConfigError: A folder is given with a revision.
        """
        revision = job.options.revision
        check(
            revision is None or not folder_at(job.source).is_dir(),
            f"revision={revision}: {job.source} is a folder, which has no revisions",
        )
        self._job = job
        self.run_dir = Path(job.options.run_dir).expanduser()
        """The folder of the runs."""
        self._datasets: dict[str, KnownDataset | None] = {}
        self._replayed: set[Results] = set()
        self.missing: dict[str, str] = {}
        """Config -> why it is not available."""
        self.skipped: dict[str, int] = {}
        """Reason -> number of files that were not replayed for it."""

    def dataset(self, config: str) -> KnownDataset | None:
        """Return a config such as `5x5`, or None if it is not available."""
        if config not in self._datasets:
            job = self._job
            try:
                local = job.data_dir / config
                if job.options.dataset is None and not (local / Manifest.FILE).is_file():
                    raise DatasetError(f"{local} holds no dataset")  # Ask no Hub.
                known = KnownDataset.read(job.source, config, job.options.revision)
                self._datasets[config] = known
            except DatasetError as error:
                self._datasets[config] = None
                self.missing[config] = str(error)
        return self._datasets[config]

    def is_compared(self, results: Results) -> bool:
        """Return whether results were checked against their dataset, which is available."""
        known = self.dataset(results.config)
        return known is not None and known.fingerprint == results.fingerprint

    def is_replayed(self, results: Results) -> bool:
        """Return whether the policy of these results was played again."""
        return results in self._replayed

    def read(self, path: Path, run_named: tuple[str, str] | None = None) -> Results:
        """Read results from a file, and check them.

        If the dataset has another fingerprint, results of a run are left unchecked, and results of
        any other policy are refused.

        Args:
            path: The file.
            run_named: The config and the name of the run that the path stands for; results of
                another policy may be there, too.

        Raises:
            DatasetError: The file cannot be read, is inconsistent, or the policy plays otherwise;
                the message has one line.
        """
        results = Results.load(path, self.dataset)
        run, known = results.run, self.dataset(results.config)
        try:
            if run is not None and run_named is not None:
                if (results.config, run.name) != run_named:
                    name = f"{results.config}/{run.name}"
                    raise ValueError(f"it belongs to the run {name}, not to this one")
                TrainingOptions.check_run(run, results.observation)
            if known is None:
                pass  # Nothing to compare with.
            elif run is not None and run.fingerprint == results.fingerprint != known.fingerprint:
                self.missing[results.config] = f"{known.name} is another dataset"
            else:
                results.require_dataset(known)
            if self._job.options.results.replay:
                self._replay(path, results)
        except (ValueError, DatasetError) as error:  # A PolicyError is a ValueError.
            raise DatasetError(f"{path} is refused: {error}") from error
        return results

    def _replay(self, path: Path, results: Results) -> None:
        """Play the policy that results name, if it is available.

        Raises:
            ValueError, DatasetError: The policy has other files than the results name, or plays
                otherwise.
            PolicyError: The policy cannot be opened, or fails.
        """
        known = self.dataset(results.config)
        if known is None or not self.is_compared(results):
            self._skip(f"{results.config} is not available")
            return
        try:
            policy = self._opened(results)
        except (DatasetError, PolicyNameError) as error:
            self._skip(str(error))
            return
        say(f"Replaying {path}")
        try:
            _require_same(results, policy)
            require_replay(results, policy, known.data)
        finally:
            close = getattr(policy, "close", None)
            if close is not None:
                close()
        self._replayed.add(results)

    def _opened(self, results: Results) -> Any:
        """Return the policy that results name; a DatasetError or PolicyNameError says why not."""
        run, policy = results.run, results.policy
        if run is not None:
            folder = self.run_dir / run.config / run.name
            if not folder.is_dir():
                raise DatasetError(f"runs are not in {self.run_dir}")
            if run.method not in TrainingOptions.METHODS:
                raise DatasetError("methods in Python are not executed")
            return open_policy(folder)
        if policy is not None:
            return open_policy(policy.source, revision=policy.commit, code=False)
        name = results.about.name
        if "/" in name or Path(name).expanduser().exists():  # The name says which policy it is.
            return open_policy(name, code=False)
        raise DatasetError("they name no files of a policy")

    def _skip(self, reason: str) -> None:
        self.skipped[reason] = self.skipped.get(reason, 0) + 1


def _require_same(results: Results, policy: Any) -> None:
    """Raise ValueError unless the files of a policy are those that results name."""
    if results.policy is not None:
        named, hashes = results.policy.files, policy.origin.files
        for name in sorted(named.keys() | hashes.keys()):
            if named.get(name) != hashes.get(name):
                raise ValueError(
                    f"it.policy names {name} with the SHA-256 {named.get(name) or 'none':.16}, but "
                    f"{policy.origin.source} has {hashes.get(name) or 'none':.16}"
                )
    told, made = results.run, policy.run
    if told is None:
        return
    if not isinstance(made, TrainedRun):
        raise ValueError(f"{policy.origin.source} holds no run")
    for name in _OF_RUN:
        claimed, right = getattr(told, name), getattr(made, name)
        if claimed != right:
            raise ValueError(f"it.run.{name} is {claimed!r:.60}, but {right!r:.60} in the run")
    claimed, right = told.evaluated["weights"], made.evaluated["weights"]
    if claimed not in (None, right):  # Earlier versions name no weights.
        raise ValueError(
            f"it.run names weights with the SHA-256 {claimed:.16}, but it has {right:.16}"
        )


def require_replay(results: Results, policy: Any, data: Dataset) -> None:
    """Play a policy and compare each episode with the one that results claim.

    A policy and a seed determine the episodes. Only where the scores of two actions are nearly
    equal may another processor or version of a library decide otherwise; the message then says
    so.

    Args:
        results: The results, of the dataset.
        policy: The policy that is said to have achieved them.
        data: The dataset.

    Raises:
        ValueError: An episode differs; the message names the first labyrinth.
        PolicyError: The policy fails, or cannot be shown these labyrinths.
    """
    shown = Evaluation.of(
        policy,
        data,
        observation=results.observation,
        image_size=results.image_size,
        seed=results.seed,
        run=results.run,
    )
    episodes = None if results.way == "look-ups" else results.episodes
    again = shown.results(list(results.splits), episodes)
    if again.way != results.way:
        raise ValueError(f"it.evaluated.way is {results.way}, but the policy plays by {again.way}")
    for split, scores in results.splits.items():
        claimed, played = scores.episodes, again.splits[split].episodes
        wrong = (claimed.outcomes != played.outcomes) | (claimed.moves != played.moves)
        for episode, number in np.argwhere(np.atleast_2d(wrong))[:1].tolist():
            outcomes, moves = (
                [np.atleast_2d(getattr(each, name))[episode, number] for each in (claimed, played)]
                for name in ("outcomes", "moves")
            )
            near = _near_tie(shown, split, number) if again.way == "look-ups" else ""
            raise ValueError(
                f"{split}: labyrinth {scores.labyrinth_ids[number]:016x} is {outcomes[0]} "
                f"after {moves[0]} moves, but {outcomes[1]} after {moves[1]} when the policy "
                f"plays it{near}"
            )
        for name in ("accuracy_on_demonstrations", "accuracy_elsewhere"):
            told, right = getattr(scores, name), getattr(again.splits[split], name)
            if told != right:
                raise ValueError(f"{split}: {name} is {told}, but {right} when the policy plays")


def _near_tie(shown: Evaluation, split: str, labyrinth: int) -> str:
    """Say so if two actions have nearly equal scores where the policy goes in a labyrinth."""
    arrays = shown.load(split)
    state, visited = int(arrays.initial[labyrinth]), []
    gap = np.inf
    while state not in visited and not arrays.terminal[state]:
        visited.append(state)
        answer = shown.player.act(arrays.observations[np.array([state])])
        scores: NDArray[Any] = np.asarray(answer)
        if scores.shape != (1, 4):
            return ""  # It answers with actions.
        second, first = np.sort(scores[0].astype(np.float64))[-2:]
        gap = min(gap, (first - second) / max(abs(first), 1e-12))
        state = int(arrays.next_state[state, scores[0].argmax()])
    if gap > CLOSE:
        return ""
    return (
        f"; there the scores of two actions differ by only {gap:.0e} of the greatest, so "
        "another machine may decide otherwise"
    )
