"""What results are checked against: their dataset and, if that is asked, their policy.

Policies of runs and those that `open_policy` opens are played again. No code is executed that a
file names: a policy in Python, and a run of a method in Python, rests on the word of whoever made
the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import Dataset, Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Evaluation, KnownDataset, Results, TrainedRun
from labyrinth_core.policies import PolicyNameError, open_policy
from labyrinth_core.storage import folder_at
from pipeline.config import Job, TrainingOptions, check
from pipeline.machinery import say
from pipeline.results.options import ResultsOptions

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
            policy, why = self._opened(results)
        except (DatasetError, PolicyNameError) as error:
            self._skip(str(error))
            return
        if policy is None:
            self._skip(why)
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

    def _opened(self, results: Results) -> tuple[Any, str]:
        """Return the policy that results name; or None, and why it is not opened."""
        run, policy = results.run, results.policy
        if run is not None:
            folder = self.run_dir / run.config / run.name
            if not folder.is_dir():
                return None, f"runs are not in {self.run_dir}"
            if run.method not in TrainingOptions.METHODS:
                return None, "methods in Python are not executed"
            return open_policy(folder), ""
        if policy is not None:
            return open_policy(policy.source, revision=policy.commit, code=False), ""
        name = results.about.name
        if "/" in name or Path(name).expanduser().exists():  # The name says which policy it is.
            return open_policy(name, code=False), ""
        return None, "they name no files of a policy"

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
