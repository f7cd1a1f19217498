r"""Show what a hidden test is worth: memorisers fall on it, and attackers who choose gain little.

    python scripts/studies/season.py memorise --public data/labyrinth --train
    python scripts/studies/season.py attack

`memorise` lets policies learn the public test of 5x5 (built by `python run.py size=5`), and judges
them there and on a season's test of 1,000 labyrinths: a table of pictures, the reference
`route_memory`, and with `--train` BC (`stages=train method=bc` with the rows of test in place of
those of train), beside BC that learnt from train.

`attack` simulates one who submits k times to n labyrinths and is right in half of them by chance.
By `choosing`, k policies are drawn and the best is kept; what they score is told in the end. By
`asking`, each score is told at once, and the attacker submits what the majority of those does that
scored more than half (Blum and Hardt 2015, arXiv:1502.04585, algorithm 1). Printed is how much more
the last policy scores than the half that it is worth.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from math import log, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from labyrinth_core import evaluate, load_policy
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.evaluation.baselines import TrainMemory
from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
from pipeline.config.run import RunConfig, resolve
from pipeline.generation.build import build
from pipeline.machinery.markdown import table
from pipeline.season.commitment import seed_of, without_seed
from pipeline.season.judge import by_chance

ROOT = Path(__file__).parents[2]
FOLDER = Path("build/memorisers")
"""For the season, the datasets and the runs."""
CONFIG = "5x5"
SECRET = bytes(32)
"""That of the season of this study; a real one is drawn by the operating system."""

SUBMISSIONS = (1, 3, 10, 30, 100, 300, 1000)
LABYRINTHS = (1_000, 10_000)
REPETITIONS = 100
ANSWERS = 101
"""The number of scores of two decimals. What an attacker submits after k - 1 of them is one of
101**(k - 1) policies, of which the best is bounded as by `by_chance`."""


def main() -> None:
    """Print the table of one of the two studies."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["memorise", "attack"])
    parser.add_argument("--public", type=Path, default=Path("data/labyrinth"))
    parser.add_argument("--train", action="store_true", help="two runs of BC, too")
    given = parser.parse_args()
    if given.what == "attack":
        print(attacks())
        return
    season = season_in(FOLDER / "season", 1_000)
    learnt = {}
    if given.train:
        learnt["BC, which learnt the public test"] = learn(
            as_train(given.public, FOLDER / "learnt"), FOLDER / "runs-of-test"
        )
        learnt["BC, which learnt train"] = learn(given.public, FOLDER / "runs-of-train")
    policies = {name: load_policy(folder) for name, folder in learnt.items()}
    print(memorisers(given.public, season, policies))


def season_in(data_dir: Path, labyrinths: int) -> Path:
    """Build the test of a season whose secret is known, and return its folder."""
    options = RunConfig(size="5", labyrinths=labyrinths, data_dir=str(data_dir), stages=("build",))
    run = resolve(options)
    seed = seed_of(SECRET, without_seed(run.dataset))
    build(replace(run, dataset=replace(run.dataset, seed=seed)))
    return data_dir


def as_train(public: Path, data_dir: Path) -> Path:
    """Write a dataset whose train has the rows of the test of another; return its folder."""
    source, folder = public / CONFIG, data_dir / CONFIG
    shutil.copytree(source, folder, dirs_exist_ok=True)
    manifest = Manifest.read(source)
    learnt = []
    for shard in manifest.of("test"):
        path = shard.path.replace("test-", "train-")
        shutil.copyfile(source / shard.path, folder / path)
        learnt.append(replace(shard, path=path, split="train"))
    others = [shard for shard in manifest.shards if shard.split != "train"]
    replace(manifest, shards=(*learnt, *others)).write(folder)
    return data_dir


def learn(data_dir: Path, runs: Path) -> Path:
    """Train BC on a dataset, unless that is done, and return the folder of the run."""
    options = ["size=5", "stages=train", "method=bc", f"data_dir={data_dir}", f"run_dir={runs}"]
    subprocess.run([sys.executable, str(ROOT / "run.py"), *options], check=True)
    return runs / CONFIG / "bc-cnn-seed0"


def memorisers(public: Path, season: Path, policies: dict[str, Any]) -> str:
    """Return the table of what memorisers and other policies achieve on both tests."""
    seen = load_arrays(public, CONFIG, "test")
    actions = {
        picture.tobytes(): optimal.argmax()
        for picture, optimal in zip(seen.observations, seen.optimal, strict=True)
    }

    def from_table(pictures: Any) -> Any:
        return np.array([actions.get(each.tobytes(), 0) for each in pictures])

    memory = TrainMemory.of(load_arrays(public, CONFIG, "test", observation="vector"))
    judged = {"a table of the pictures of the public test": from_table, **policies}
    found: dict[str, list[tuple[float, float]]] = {}
    for place in (public, season):
        arrays = load_arrays(place, CONFIG, "test", observation="vector")
        figures = memory.figures(arrays)[1]["route_memory"]
        for name, policy in judged.items():
            scores = evaluate(policy, place, CONFIG, splits=["test"]).splits["test"]
            found.setdefault(name, []).append((scores.spl, scores.sr))
        name = "route_memory of the public test"
        found.setdefault(name, []).append((figures["spl"], figures["sr"]))
    rows = [
        [name, *(f"{share:.3f}" for pair in pairs for share in pair)]
        for name, pairs in found.items()
    ]
    heading = ["policy", "SPL, public test", "SR", "SPL, season", "SR"]
    return table(heading, rows)


def attacks() -> str:
    """Return the table of what attackers gain."""
    rows = []
    for count in LABYRINTHS:
        for number in SUBMISSIONS:
            gains = [mean_gain(attack, number, count) for attack in (choose, ask)]
            told = sqrt((number - 1) * log(ANSWERS) / (2 * count))
            figures = (gains[0], by_chance(number, count), gains[1], told)
            rows.append([f"{count:,}", f"{number:,}", *(f"{each:.3f}" for each in figures)])
    heading = ["labyrinths", "submissions", "choosing", "bound", "asking", "bound"]
    return table(heading, rows)


def mean_gain(
    attack: Callable[[int, int, np.random.Generator], float],
    submissions: int,
    labyrinths: int,
) -> float:
    """Return what an attack gains in the mean."""
    rng = np.random.default_rng([submissions, labyrinths])
    return float(np.mean([attack(submissions, labyrinths, rng) for _ in range(REPETITIONS)]))


def choose(submissions: int, labyrinths: int, rng: np.random.Generator) -> float:
    """Return how much more than a half the best of several random policies scores."""
    return float((rng.binomial(labyrinths, 0.5, submissions) / labyrinths).max() - 0.5)


def ask(submissions: int, labyrinths: int, rng: np.random.Generator) -> float:
    """Return how much more than a half the majority scores of those that scored more.

    The judge tells scores to two decimals. The last submission is the majority itself.
    """
    right = rng.random((submissions - 1, labyrinths)) < 0.5
    scores = right.mean(axis=1).round(2)
    signs = np.sign(scores - 0.5).astype(np.float32)
    votes = 2 * (signs @ right.astype(np.float32)) - signs.sum()
    drawn = rng.random(labyrinths) < 0.5
    return float(np.where(votes == 0, drawn, votes > 0).mean() - 0.5)


if __name__ == "__main__":
    main()
