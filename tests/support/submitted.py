"""Results for tests, as anybody would save them or a run leaves them, and small changes to them."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from labyrinth_core import evaluate
from labyrinth_core.evaluation import Description, KnownDataset, Results, TrainedRun
from labyrinth_core.evaluation.replanner import Replanner
from labyrinth_core.evaluation.scores import Episodes, Scores

ACCURACIES = ("accuracy_on_demonstrations", "accuracy_elsewhere")


def forgetful(height: int, width: int, share: float = 0.2, seed: int = 0) -> Any:
    """Return a policy that plans, but errs in a share of the states, always in the same ones."""
    planner = Replanner(height, width, memory=False)

    def act(observations):
        weights = (np.arange(1, observations.shape[1] + 1) + seed) ** 2
        drawn = (observations @ weights * 2654435761) % 2**32
        return np.where(drawn < share * 2**32, drawn % 4, planner.act(observations))

    return act


def results_of(source: Any, config: str, policy: Any, **options: Any) -> Results:
    """Return what a policy that looks at vectors achieves."""
    return evaluate(policy, source, config, observation="vector", **options)


def of_run(results: Results, method: str = "bc", seed: int = 0, **changed: Any) -> Results:
    """Return results as those of a run that learnt from the dataset that it is judged on."""
    about: dict[str, Any] = {
        "method": method,
        "encoder": "cnn",
        "protocol": "default",
        "seed": seed,
        "settings": {"epochs": 7},
        "config": results.config,
        "dataset": results.dataset,
        "fingerprint": results.fingerprint,
        "training": {
            "epochs": 7,
            "seconds": 90.5,
            "selected": {"epoch": 5},
            "computed": {"device": "cpu"},
        },
        "evaluated": {"device": "cpu", "versions": {}, "weights": None},
    }
    return replace(
        results,
        observation="image",
        image_size=64,
        seed=seed,
        baselines=_baselines(results, changed.get("train_labyrinths")),
        run=TrainedRun(**about | changed),
    )


def of_few(results: Results, count: int) -> Results:
    """Return the results of a run as if it had learnt from the first labyrinths of train alone.

    It is judged on these labyrinths, and the references know these.
    """
    assert results.run is not None
    known = KnownDataset.read(results.dataset, results.config)
    splits = {}
    for split, scores in results.splits.items():
        right, episodes = known.split(split, count), scores.episodes
        first = slice(len(right.distance))
        splits[split] = replace(
            scores,
            episodes=replace(
                episodes, outcomes=episodes.outcomes[..., first], moves=episodes.moves[..., first]
            ),
            labyrinth_ids=right.labyrinth_ids,
            distance=right.distance,
            known_route=right.known_route,
            **dict.fromkeys(ACCURACIES, 1.0),
        )
    run = replace(results.run, train_labyrinths=count)
    return replace(results, splits=splits, baselines=_baselines(results, count), run=run)


@lru_cache
def _baselines(results: Results, learnt: int | None) -> dict[str, dict[str, Any]]:
    """Return the figures of all baselines, of which `evaluate` leaves out the blind ones."""
    known = KnownDataset.read(results.dataset, results.config)
    by_split = {split: known.split(split, learnt).baselines for split in results.splits}
    names = next(iter(by_split.values()))
    return {name: {split: found[name] for split, found in by_split.items()} for name in names}


def keep(results: Results, run_dir: Path) -> Path:
    """Leave the results of a run where the stage `evaluate` does, and return the file."""
    assert results.run is not None
    path = run_dir / results.config / results.run.name / "results.json"
    results.save(path, name=results.run.name)
    return path


def content_of(results: Results, name: str = "mine", **about: Any) -> dict[str, Any]:
    """Return the content of the file; the results of a run have its name."""
    name = name if results.run is None else results.run.name
    content: dict[str, Any] = deepcopy(results.to_json(Description(name, **about)))
    return content


def add_up(told: dict[str, Any], cells: int) -> None:
    """Make the figures of a split follow from its outcomes and moves, as a forger would."""
    episodes = Episodes.of_letters(told["outcomes"], told["moves"], cells)
    distance = np.array(told["distance"])
    known = np.array([mark == "1" for mark in told["known_route"]])[: len(distance)]
    accuracies = (told[name] for name in ACCURACIES)
    told |= Scores(episodes, distance, distance, *accuracies, known).figures()
