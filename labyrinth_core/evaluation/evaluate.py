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

from labyrinth_core import typed
from labyrinth_core.checks import whole
from labyrinth_core.data import SPLITS, Dataset, DatasetConfig
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation.answers import fitted
from labyrinth_core.evaluation.baselines import TrainMemory
from labyrinth_core.evaluation.description import Origin, TrainedRun
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.memorised import Receipt, receipt_of, train_of
from labyrinth_core.evaluation.playing import ADVICE, Player
from labyrinth_core.evaluation.replanner import replan
from labyrinth_core.evaluation.results import Results
from labyrinth_core.evaluation.scores import Scores
from labyrinth_core.evaluation.twins import train_set
from labyrinth_core.pictures import ObservationSpec


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


def memorised(
    policy: Any,
    source: str | Path | Dataset,
    config: str | None = None,
    *,
    split: str = "test",
    controls: int = 200,
    train_labyrinths: int | None = None,
    observation: str | None = None,
    image_size: int | None = None,
    episodes: int | None = None,
    seed: int = 0,
    revision: str | None = None,
) -> Receipt:
    """Return whether a policy follows its own training set where this is unusual.

    For each state of the split, the twin is the demonstrated state of train that looks most like
    it. If the policy takes the action of the twin more often than that of the twins in control
    training sets, it remembers. The controls are drawn as train was, with other seeds. So a policy
    that does not depend on the choice of its train has any rank among them with equal probability.

    Args:
        policy: The policy, as for `evaluate`. It has learnt from train of this dataset, and from
            nothing else that depends on the choice of these labyrinths.
        source: A `Dataset`; or its folder, or its id on the Hub such as `user/labyrinth`.
        config: Name of the dataset's config, such as `5x5` or `5x5-key_and_door`; not with a
            `Dataset`.
        split: "test" or "validation".
        controls: The number of control training sets, 10 to 10,000; with 200, the smallest p is
            0.005.
        train_labyrinths: The number of labyrinths that the policy has learnt from, the first ones
            of train; None for all.
        observation: As for `evaluate`.
        image_size: As for `evaluate`.
        episodes: Number of episodes in each labyrinth, for a stochastic policy.
        seed: Seed of the generator `rng` of a stochastic policy.
        revision: Branch, tag or commit on the Hub; not for folders or with a `Dataset`.

    Raises:
        ValueError: An argument has a value that is not allowed, or no control could have been the
            train of this dataset: its other splits depend on train, its labyrinths are not those
            of its config, or there are too few others.
        PolicyError: As for `evaluate`.
        DatasetError: The dataset or split does not exist, or was replaced meanwhile.
    """
    data = Dataset.of(source, config, revision)
    shown = Evaluation.of(policy, data, observation=observation, image_size=image_size, seed=seed)
    receipt = shown.receipt(split, controls, train_labyrinths=train_labyrinths, episodes=episodes)
    data.require_unchanged()
    return receipt


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
        seed = whole("seed", seed, 0, typed.MOST_SEED) if run is None else run.seed
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

    def load(
        self, split: str, observation: str | None = None, *, hold: bool = True
    ) -> LabyrinthArrays:
        """Return the labyrinths of a split with the policy's observation, or with another one.

        If the policy learnt from the first labyrinths of train alone, only they and those derived
        from them are those of a split: the others have structures that are new to the policy.
        `hold` is that of `LabyrinthArrays.of`.
        """
        run, data = self.run, self.data
        known = run is not None and run.fingerprint == data.fingerprint
        learnt = run.first_labyrinths if run is not None and known else None
        kind = observation or self.spec.observation
        shown = ObservationSpec(kind, self.spec.image_size, draw=True, resize=self.spec.resize)
        return LabyrinthArrays.of(data.of_first(split, learnt), shown, hold=hold)

    def results(
        self,
        splits: Sequence[str] | None = None,
        episodes: int | None = None,
        *,
        trained_on: Callable[[], Dataset] | None = None,
        follow: Callable[[Sequence[str]], Iterable[str]] = iter,
        advice: str = ADVICE,
    ) -> Results:
        """Play all episodes and return the results.

        Args:
            splits: As for `evaluate`.
            episodes: As for `evaluate`.
            trained_on: Returns the dataset that the run learnt from, which the references know if
                it is another one of the same size and task; None if it is not available.
            follow: Yields the splits, to show progress.
            advice: What to do with a policy that answers the same observations differently.

        Raises:
            ValueError, PolicyError, DatasetError: As for `evaluate`.
        """
        if episodes is not None:
            episodes = whole("episodes", episodes, 1, typed.MOST_EPISODES)
        about, run = self.data.manifest.config, self.run
        learnt = None if run is None or trained_on is None else self._learnt(run, trained_on)
        memory = TrainMemory.of(learnt or self.load("train", hold=False))
        scores: dict[str, Scores] = {}
        baselines: dict[str, dict[str, Mapping[str, float]]] = {}
        for split in follow(_chosen(splits, self.data)):
            own = memory.train if split == "train" and learnt is None else None
            scores[split], beside = self._judge(split, memory, episodes, advice, own)
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
        controls = whole("controls", controls, *typed.CONTROLS)
        if episodes is not None:
            episodes = whole("episodes", episodes, 1, typed.MOST_EPISODES)
        own = train_of(self.data, split, train_labyrinths) if train is None else train_set(train)
        arrays = self.load(split)
        return receipt_of(
            self.player, arrays, own, split=split, controls=controls, episodes=episodes
        )

    @staticmethod
    def train_of(data: Dataset) -> DatasetConfig:
        """Return the config of a dataset that a policy has learnt from, for `receipt`.

        Raises:
            ValueError: No control could have been the train of this dataset.
        """
        return train_of(data, "test")[0]

    def _way(self, episodes: int | None) -> str:
        """Return how the policy is judged: `look-ups` if it remembers nothing, else `steps`."""
        return "look-ups" if self.player.forgets and episodes is None else "steps"

    def _judge(
        self,
        split: str,
        memory: TrainMemory,
        episodes: int | None,
        advice: str,
        loaded: LabyrinthArrays | None,
    ) -> tuple[Scores, dict[str, dict[str, float]]]:
        """Return the scores of the policy on a split, and the figures of each baseline.

        Observations of policies that are stepped are held, as one state may be seen often; look-ups
        show each state once.

        Args:
            split: The split.
            memory: What the baselines know.
            episodes: As for `evaluate`.
            advice: What to do with a policy that answers the same observations differently.
            loaded: The labyrinths of the split without held observations, if they are there.
        """
        steps = self._way(episodes) == "steps"
        arrays = self.load(split, hold=steps) if loaded is None or steps else loaded
        # A run is compared with the baselines that do not look at a labyrinth, too.
        known, beside = memory.figures(arrays, blind=self.run is not None)
        if steps:
            scores = Scores.of(self.player.step_through(arrays, episodes or 1), arrays)
        else:
            self.player.require_repeatable(arrays, advice)
            scores = self.player.score(arrays)
        del arrays  # Frees the arrays before others are loaded.
        if self.data.manifest.config.task.rules.hides:
            beside |= replan(self.load(split, "vector"))
        return replace(scores, known_route=known), beside

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
        train = other["train"].filter(labyrinths=run.first_labyrinths)
        return LabyrinthArrays.of(train, shown, hold=False)


_LABYRINTHS = ("height", "width", "task")


def _chosen(splits: Sequence[str] | None, data: Dataset) -> list[str]:
    if splits is None:
        return [split for split in data.splits if split not in SPLITS.not_evaluated]
    try:
        chosen = [splits] if isinstance(splits, str) else list(splits)
    except TypeError as error:
        raise ValueError(f"splits={splits!r:.60}: give names such as ['test']") from error
    for split in chosen or ["[]"]:
        data.manifest.of(split)  # Raises a DatasetError if there is no such split.
    return chosen
