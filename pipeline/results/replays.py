"""Play the policies of results again: those of runs and those that `open_policy` opens.

No code is executed that a file names: a policy in Python, and a run of a method in Python, rests on
the word of whoever made the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation.answers import PolicyError
from labyrinth_core.evaluation.description import TrainedRun
from labyrinth_core.evaluation.replaying import require_replay
from labyrinth_core.evaluation.results import Results
from labyrinth_core.policies.opening import PolicyNameError, open_policy
from pipeline.config.training import METHODS
from pipeline.machinery.console import say
from pipeline.results.available import Available

_OF_RUN = (
    *("method", "encoder", "protocol", "train_labyrinths", "seed", "settings", "config"),
    *("fingerprint", "training"),
)


class Replays:
    """Which results were replayed, and why others were not."""

    def __init__(self, run_dir: Path, available: Available) -> None:
        """Look for the policies of runs in `run_dir`."""
        self._run_dir, self._available = run_dir, available
        self._done: set[Results] = set()
        self.skipped: dict[str, int] = {}
        """Reason -> number of files that were not replayed for it."""

    def __contains__(self, results: Results) -> bool:
        """Return whether these results were replayed."""
        return results in self._done

    def __call__(self, path: Path, results: Results) -> None:
        """Play the policy that results name, if it is available.

        Raises:
            DatasetError: The policy has other files than the results name, or plays otherwise.
        """
        if not self._available.has(results):
            self._skip(f"{results.config} is not available")
            return
        try:
            policy, why = self._opened(results)
        except (DatasetError, PolicyNameError) as error:
            self._skip(str(error))
            return
        except PolicyError as error:
            raise DatasetError(f"{path} is refused: {error}") from error
        if policy is None:
            self._skip(why)
            return
        known = self._available(results.config)
        assert known is not None  # It is available.
        say(f"Replaying {path}")
        try:
            _require_same(results, policy)
            require_replay(results, policy, known.data)
        except (ValueError, DatasetError) as error:
            raise DatasetError(f"{path} is refused: {error}") from error
        finally:
            close = getattr(policy, "close", None)
            if close is not None:
                close()
        self._done.add(results)

    def _opened(self, results: Results) -> tuple[Any, str]:
        """Return the policy that results name; or None, and why it is not opened."""
        run, policy = results.run, results.policy
        if run is not None:
            folder = self._run_dir / run.config / run.name
            if not folder.is_dir():
                return None, f"runs are not in {self._run_dir}"
            if run.method not in METHODS:
                return None, "methods in Python are not executed"
            return open_policy(folder), ""
        if policy is not None:
            return open_policy(policy.source, revision=policy.commit, code=False), ""
        name = results.method.name if results.method is not None else ""
        if "/" in name or Path(name).expanduser().exists():  # The name says which policy it is.
            return open_policy(name, code=False), ""
        return None, "they name no files of a policy"

    def _skip(self, reason: str) -> None:
        self.skipped[reason] = self.skipped.get(reason, 0) + 1


def _require_same(results: Results, policy: Any) -> None:
    """Raise ValueError unless the files of a policy are those that results name."""
    if results.policy is not None:
        named, found = results.policy.files, policy.origin.files
        for name in sorted(named.keys() | found.keys()):
            if named.get(name) != found.get(name):
                raise ValueError(
                    f"it.policy names {name} with the SHA-256 {named.get(name) or 'none':.16}, but "
                    f"{policy.origin.source} has {found.get(name) or 'none':.16}"
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
