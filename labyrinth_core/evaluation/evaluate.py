"""`evaluate` any policy on a dataset.

from labyrinth_core import Dataset, evaluate

results = evaluate(policy, Dataset("data/labyrinth", "5x5"))
print(results)
results.save("results/mine.json", name="my method", url="https://example.org")
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from labyrinth_core.checks import whole
from labyrinth_core.data import Dataset, DatasetConfig
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation.answers import Player, fitted
from labyrinth_core.evaluation.baselines import TrainMemory
from labyrinth_core.evaluation.description import MOST_EPISODES, MOST_SEED, Origin, TrainedRun
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.memorised import Receipt, receipt_of, train_of
from labyrinth_core.evaluation.playing import require_repeatable, step_through
from labyrinth_core.evaluation.replanner import replan
from labyrinth_core.evaluation.results import Results
from labyrinth_core.evaluation.scores import Scores, score
from labyrinth_core.evaluation.twins import train_set
from labyrinth_core.pictures.observations import ObservationSpec
from labyrinth_core.world import Task

NOT_EVALUATED = ("random",)
"""Splits that hold another policy's episodes in the labyrinths of train."""


def evaluate(
    policy: Any,
    source: str | Path | Dataset,
    config: str | None = None,
    *,
    observation: str | None = None,
    image_size: int | None = None,
    episodes: int | None = None,
    seed: int = 0,
    splits: Sequence[str] | None = None,
    revision: str | None = None,
) -> Results:
    """Return the results of a policy in the labyrinths of a dataset.

    A policy is one of the following. It answers with an array of NumPy, PyTorch or JAX: B actions,
    or scores of shape (B, 4), of which the highest counts.

    - A function from B observations to answers, or a PyTorch module, which is given tensors. It has
      no memory, so it is called once for each state of each labyrinth.
    - An object with `reset(count)` and `act(observations)`, which may have memory. All `count`
      episodes are stepped in lock-step; it still sees the final states of finished episodes, and
      its answers there are ignored. If `act` takes an argument `episodes`, it sees only the
      episodes that go on, and is given their numbers, from 0 to `count` - 1.
    - Either of them, if the function or `reset` takes an argument `rng`: a
      `numpy.random.Generator`, for a stochastic policy. It is stepped, too.
    - A model or policy of Stable-Baselines3, or any object with its `predict`, called with
      `deterministic=True`. If it returns a state, it has memory and is stepped.

    A policy with attributes for what it has to be shown, such as those of `load_policy`, is shown
    that: see `labyrinth_core.evaluation.answers.fitted`.

    Args:
        policy: The policy to evaluate.
        source: A `Dataset`; or its folder, or its id on the Hub such as `user/labyrinth`.
        config: Name of the dataset's config, such as `5x5` or `5x5-key_and_door`; not with a
            `Dataset`.
        observation: What the policy is shown: "image", uint8 (B, image_size, image_size, 3);
            "vector", int32 (B, length); or "text", a list of B texts in the language of labyrinths,
            with the agent as `@`. None for the policy's own, or "image".
        image_size: Pixels on each side of the pictures. None for the policy's own, or 64.
        episodes: Number of episodes to step in each labyrinth, for a stochastic policy. None for
            look-ups if the policy allows them, else one episode.
        seed: Seed of the generator `rng`.
        splits: The splits to evaluate on; None for all but `random`.
        revision: Branch, tag or commit on the Hub; not for folders or with a `Dataset`.

    Raises:
        ValueError: An argument has a value that is not allowed.
        PolicyError: The policy is not one of these, raises an error, answers with anything but
            actions, or cannot be shown these labyrinths.
        DatasetError: The dataset or split does not exist, or was replaced meanwhile.
    """
    data = Dataset.of(source, config, revision)
    shown = Evaluation.of(policy, data, observation=observation, image_size=image_size, seed=seed)
    return shown.results(splits, episodes)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A policy, and the labyrinths of a dataset as they are shown to it."""

    data: Dataset
    player: Player
    spec: ObservationSpec
    """What the policy is shown."""
    seed: int
    """The seed of the generator that the policy may take."""
    origin: Origin | None = None
    """The files that the policy was opened from, if `open_policy` opened it."""
    run: TrainedRun | None = None
    """The run that trained it, if the results are those of the run."""

    @classmethod
    def of(
        cls,
        policy: Any,
        data: Dataset,
        *,
        observation: str | None = None,
        image_size: int | None = None,
        seed: int = 0,
        run: TrainedRun | None = None,
    ) -> Evaluation:
        """Return any policy with a dataset; the arguments are those of `evaluate`.

        The results of a `run` have its seed, and say that it trained the policy.

        Raises:
            ValueError, PolicyError: As for `evaluate`.
        """
        seed = whole("seed", seed, 0, MOST_SEED) if run is None else run.seed
        origin, about = getattr(policy, "origin", None), data.manifest.config
        policy, spec = fitted(
            policy,
            about.height,
            about.width,
            about.task,
            observation=observation,
            image_size=image_size,
        )
        origin = origin if isinstance(origin, Origin) else None
        return cls(data, Player.of(policy, seed), spec, seed, origin, run)

    def load(self, split: str, observation: str | None = None) -> LabyrinthArrays:
        """Return the labyrinths of a split with the policy's observation, or with another one.

        If the policy learnt from the first labyrinths of train alone, only they and those derived
        from them are those of a split: the others have structures that are new to the policy.
        """
        run, data = self.run, self.data
        known = run is not None and run.fingerprint == data.fingerprint
        learnt = run.first_labyrinths if run is not None and known else None
        kind = observation or self.spec.observation
        shown = ObservationSpec(kind, self.spec.image_size, draw=True, resize=self.spec.resize)
        return LabyrinthArrays.of(data.of_first(split, learnt), shown)

    def results(
        self,
        splits: Sequence[str] | None = None,
        episodes: int | None = None,
        *,
        trained_on: Callable[[], Dataset] | None = None,
        follow: Callable[[Sequence[str]], Iterable[str]] = iter,
    ) -> Results:
        """Play all episodes and return the results.

        Args:
            splits: As for `evaluate`.
            episodes: As for `evaluate`.
            trained_on: Returns the dataset that the run learnt from, which the references know if
                it is another one of the same size and task; None if it is not available.
            follow: Yields the splits, to show progress.

        Raises:
            ValueError, PolicyError, DatasetError: As for `evaluate`.
        """
        if episodes is not None:
            episodes = whole("episodes", episodes, 1, MOST_EPISODES)
        about, run = self.data.manifest.config, self.run
        learnt = None if run is None or trained_on is None else self._learnt(run, trained_on)
        memory = TrainMemory.of(learnt or self.load("train", "vector"))
        scores: dict[str, Scores] = {}
        baselines: dict[str, dict[str, Mapping[str, float]]] = {}
        for split in follow(_chosen(splits, self.data)):
            scores[split], beside = self._judge(split, memory, about.task, episodes)
            for name, figures in beside.items():
                baselines.setdefault(name, {})[split] = figures
        self.data.require_unchanged()
        if run is not None:
            run = replace(run, references_know=None if learnt is None else run.fingerprint)
        return Results(
            dataset=str(self.data.source),
            revision=self.data.revision,
            config=about.name,
            fingerprint=self.data.fingerprint,
            observation=self.spec.observation,
            image_size=self.spec.image_size if self.spec.observation == "image" else None,
            way=self._way(episodes),
            episodes=episodes or 1,
            seed=self.seed,
            splits=scores,
            baselines=baselines,
            run=run,
            policy=None if run is not None else self.origin,
        )

    def receipt(
        self,
        split: str,
        controls: int,
        *,
        train: DatasetConfig | None = None,
        train_labyrinths: int | None = None,
        episodes: int | None = None,
    ) -> Receipt:
        """Return whether the policy follows its own train in a split; see `memorised`.

        Args:
            split: As for `memorised`.
            controls: As for `memorised`.
            train: The config of another dataset that the policy has learnt from, on whose train
                these labyrinths do not depend; None for this dataset.
            train_labyrinths: As for `memorised`.
            episodes: As for `memorised`.

        Raises:
            ValueError, PolicyError, DatasetError: As for `memorised`.
        """
        own = train_of(self.data, split, train_labyrinths) if train is None else train_set(train)
        arrays = self.load(split)
        return receipt_of(
            self.player, arrays, own, split=split, controls=controls, episodes=episodes
        )

    def _way(self, episodes: int | None) -> str:
        """Return how the policy is judged: `look-ups` if it remembers nothing, else `steps`."""
        return "look-ups" if self.player.forgets and episodes is None else "steps"

    def _judge(
        self, split: str, memory: TrainMemory, task: Task, episodes: int | None
    ) -> tuple[Scores, dict[str, dict[str, float]]]:
        """Return the scores of the policy on a split, and the figures of each baseline."""
        arrays = self.load(split)
        # A run is compared with the baselines that do not look at a labyrinth, too.
        known, beside = memory.figures(arrays, blind=self.run is not None)
        if self._way(episodes) == "look-ups":
            advice = "give episodes=1 or more if it draws at random"
            require_repeatable(self.player, arrays, advice)
            found = score(self.player.act, arrays)
        else:
            found = Scores.of(step_through(self.player, arrays, episodes or 1), arrays)
        del arrays  # Frees the arrays before others are loaded.
        if task.rules.hides:
            beside |= replan(self.load(split, "vector"))
        return replace(found, known_route=known), beside

    def _learnt(self, run: TrainedRun, trained_on: Callable[[], Dataset]) -> LabyrinthArrays | None:
        """Return the labyrinths that a run learnt from; None if they are unavailable.

        Also None if it is judged on its own dataset, or on one of another size or task, of which
        nothing could be remembered.
        """
        here = self.data.manifest.config
        if run.fingerprint == self.data.fingerprint:
            return None
        try:
            other = trained_on()
        except DatasetError:
            return None
        there = other.manifest.config
        alike = all(getattr(here, name) == getattr(there, name) for name in _LABYRINTHS)
        if not alike or other.fingerprint != run.fingerprint:
            return None
        shown = ObservationSpec("vector", self.spec.image_size, draw=True)
        return LabyrinthArrays.of(other["train"].filter(labyrinths=run.first_labyrinths), shown)


_LABYRINTHS = ("height", "width", "task")


def _chosen(splits: Sequence[str] | None, data: Dataset) -> list[str]:
    if splits is None:
        return [split for split in data.splits if split not in NOT_EVALUATED]
    try:
        chosen = [splits] if isinstance(splits, str) else list(splits)
    except TypeError as error:
        raise ValueError(f"splits={splits!r:.60}: give names such as ['test']") from error
    for split in chosen or ["[]"]:
        data.manifest.of(split)  # Raises a DatasetError if there is no such split.
    return chosen
