"""Train policies and ask whether each follows its own train: docs/studies/memorising.md.

    python scripts/studies/memorising.py --list
    OMP_NUM_THREADS=1 nohup nice -n 19 python scripts/studies/memorising.py --kept FOLDER &
    OMP_NUM_THREADS=1 nohup nice -n 19 python scripts/studies/memorising.py gail --kept FOLDER &

The last line asks some policies only, those whose name contains one of the texts. Each receipt is
kept in FOLDER, by default docs/results/memorising; a policy that is kept there, or in the default,
is left out, and a training run that was killed goes on from its checkpoint. Datasets and runs lie
in `--work`. `--trained` asks the policies that are trained already, and trains no others.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from run_queue import ROOT, processor_seconds, program

from labyrinth_core import Dataset, evaluate, load_arrays, load_policy, memorised
from labyrinth_core.evaluation import LabyrinthArrays
from labyrinth_core.evaluation.baselines import TrainMemory, surroundings
from labyrinth_core.evaluation.memorised import Receipt
from labyrinth_core.storage import File

KEPT = ROOT / "docs/results/memorising"
WORK = ROOT / "data/memorising"
CONTROLS = 200

TWENTY = range(1001, 1021)
"""The seeds of twenty datasets, each with a BC policy, for the study of validity."""
NEIGHBOURS = 4
"""The number of next datasets, in a circle, whose trains each of these policies is asked about."""
SIX = ("bc", "dagger", "gail", "bco", "sqil", "iupe")

HOURS = {"bc": 0.016, "dagger": 0.06, "gail": 0.42, "bco": 0.09, "sqil": 0.1, "iupe": 0.1} | {
    "planner": 0.13,
    "mapper": 0.22,
}
"""Hours of a run of each method on 100 labyrinths, about: of BC on one core, of the others on the
clock of the runs in docs/results."""


@dataclass(frozen=True)
class Asked:
    """A policy that is asked about its own train, and about trains that it never saw."""

    name: str
    train: int
    """The seed of the dataset that it has learnt from."""
    method: str
    seed: int = 0
    options: str = ""
    """Further options of training."""
    dataset: str = ""
    """Further options of the dataset."""
    labyrinths: int | None = None
    """The number of labyrinths that it has learnt from; None for all."""
    others: tuple[int, ...] = ()
    """The seeds of datasets whose trains it never saw, and is asked about, too."""

    @property
    def hours(self) -> float:
        """The hours of training on one core, estimated."""
        name, _, number = self.name.partition("-bc-")
        scale = int(number) / 100 if name in ("epochs", "labyrinths") else 1
        return scale * HOURS.get(self.method, 0)

    def folder(self, seed: int) -> str:
        """The name of the folder of a dataset."""
        return "-".join([f"d{seed}", *self.dataset.replace("=", "").split()])


def planned() -> Iterator[Asked]:
    """Yield all policies: those without training, those of validity, and the methods."""
    for name in REFERENCES:
        for seed in range(5 if name == "random" else 1):
            yield Asked(f"{name.replace(' ', '-')}-{seed}", 0, name, seed)
    yield Asked("released-planner-0", 0, "released")
    yield Asked("method-bc-0", 0, "bc")
    for number, train in enumerate(TWENTY):
        others = tuple(TWENTY[(number + step) % 20] for step in range(1, 1 + NEIGHBOURS))
        yield Asked(f"validity-bc-{train}", train, "bc", train, others=others)
        yield Asked(f"route-memory-of-{train}", train, "route memory")
    for seed in range(5):
        for method in (*SIX, "planner", "mapper"):
            if (method, seed) != ("bc", 0):
                yield Asked(f"method-{method}-{seed}", 0, method, seed)
    for epochs in (5, 10, 20, 50, 200):
        yield Asked(f"epochs-bc-{epochs}", 0, "bc", 0, f"method.epochs={epochs}")
    for count in (25, 50):
        options = f"train_labyrinths={count}"
        yield Asked(f"labyrinths-bc-{count}", 0, "bc", 0, options, labyrinths=count)
    for count in (400, 1000):
        yield Asked(f"labyrinths-bc-{count}", 0, "bc", 0, dataset=f"labyrinths={count}")
    yield Asked("noise-bc-0", 0, "bc", 0, dataset="demonstrations.noise=0.3")


# Policies that need no training, as actions in the states of test.


def _solver(test: LabyrinthArrays, memory: TrainMemory, seed: int) -> np.ndarray:  # noqa: ARG001
    return test.optimal.argmax(axis=1)


def _random(test: LabyrinthArrays, memory: TrainMemory, seed: int) -> np.ndarray:  # noqa: ARG001
    return np.random.default_rng(seed).integers(4, size=len(test.terminal))


def _local_walls(test: LabyrinthArrays, memory: TrainMemory, seed: int) -> np.ndarray:  # noqa: ARG001
    return memory.actions[test.position, surroundings(test)]


def _route_memory(test: LabyrinthArrays, memory: TrainMemory, seed: int) -> np.ndarray:  # noqa: ARG001
    """Return the first action of the remembered way from each state, else the usual in its cell."""
    actions = memory.majority[test.position]
    for state in np.flatnonzero(~test.terminal).tolist():
        here = replace(test.labyrinths[test.labyrinth[state]], start=int(test.position[state]))
        way = memory.routes.best(here)
        actions[state] = actions[state] if way is None else way[0]
    return actions


REFERENCES: dict[str, Callable[[LabyrinthArrays, TrainMemory, int], np.ndarray]] = {
    "solver": _solver,
    "random": _random,
    "local walls": _local_walls,
    "route memory": _route_memory,
}


class Table:
    """A policy that is a table from vectors to actions."""

    observation = "vector"

    def __init__(self, arrays: LabyrinthArrays, actions: np.ndarray) -> None:
        vectors = (vector.tobytes() for vector in np.asarray(arrays.observations))
        self._actions = dict(zip(vectors, actions.tolist(), strict=True))

    def __call__(self, vectors: np.ndarray) -> np.ndarray:
        """Return the actions; in states that the table does not hold, 0."""
        return np.array([self._actions.get(vector.tobytes(), 0) for vector in vectors])


def policy_of(asked: Asked, work: Path, *, trained_only: bool) -> Any:
    """Return a policy, after training it if necessary; None if that is not allowed."""
    data, config = work / "data" / asked.folder(asked.train), "5x5"
    if asked.method in REFERENCES:
        train, test = (
            load_arrays(data, config, split, observation="vector") for split in ("train", "test")
        )
        memory = TrainMemory.of(train)
        return Table(test, REFERENCES[asked.method](test, memory, asked.seed))
    if asked.method == "released":
        return load_policy(ROOT / "docs/results/released/5x5/planner-seed0")
    extra = asked.options.replace("=", "").replace(".", "-").split()
    runs = work / "-".join(["runs", *extra]) / asked.folder(asked.train)
    done = list(runs.glob(f"{config}/{asked.method}*seed{asked.seed}*/run.json"))
    if not done and trained_only:
        return None
    if not done:
        program(
            f"run.py size=5 dataset={data} method={asked.method} seed={asked.seed} {asked.options} "
            f"run_dir={runs} threads=1 stages=train"
        )
        done = list(runs.glob(f"{config}/{asked.method}*seed{asked.seed}*/run.json"))
    return load_policy(done[0].parent)


def ask(asked: Asked, work: Path, *, trained_only: bool) -> dict[str, Any] | None:
    """Return the receipt of a policy and its success on test; None if it is not trained."""
    for seed in (asked.train, *asked.others):
        folder = work / "data" / asked.folder(seed)
        if not folder.exists():
            program(f"run.py size=5 seed={seed} {asked.dataset} data_dir={folder} stages=build")
    before, began = processor_seconds() + time.process_time(), time.time()
    policy = policy_of(asked, work, trained_only=trained_only)
    if policy is None:
        return None

    def receipt_in(seed: int) -> Receipt:
        data = Dataset(work / "data" / asked.folder(seed), "5x5")
        return memorised(policy, data, controls=CONTROLS, train_labyrinths=asked.labyrinths)

    own = Dataset(work / "data" / asked.folder(asked.train), "5x5")
    scores = evaluate(policy, own, splits=["test"]).splits["test"]
    receipt = receipt_in(asked.train)
    unseen = {seed: receipt_in(seed) for seed in asked.others}
    spent = processor_seconds() + time.process_time() - before, time.time() - began
    figures = ("sr", "sr_known_route", "sr_new_route", "accuracy_elsewhere")
    return {
        **asdict(asked),
        "fingerprint": own.fingerprint,
        "hours": [round(each / 3600, 4) for each in spent],
        "test": {name: getattr(scores, name) for name in figures},
        "receipt": asdict(replace(receipt, copies=receipt.copies[:3])),
        "unseen": {
            seed: {"excess": each.excess, "sd": each.controls[1], "p": each.p}
            for seed, each in unseen.items()
        },
    }


def main() -> None:
    """Ask all policies that are not kept, or list them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", nargs="*", help="only policies whose name contains this")
    parser.add_argument("--kept", type=Path, default=KEPT, help="where to keep the receipts")
    parser.add_argument("--work", type=Path, default=WORK, help="folder of datasets and runs")
    parser.add_argument("--list", action="store_true", help="only list what is missing")
    parser.add_argument("--trained", action="store_true", help="train nothing")
    given = parser.parse_args()
    kept, work = given.kept.resolve(), given.work.resolve()
    kept.mkdir(parents=True, exist_ok=True)
    for asked in planned():
        path = kept / f"{asked.name}.json"
        if path.exists() or (KEPT / path.name).exists():
            continue
        if given.part and not any(part in asked.name for part in given.part):
            continue
        if given.list:
            print(f"{asked.hours:5.2f} h  {asked.name}")
            continue
        found = ask(asked, work, trained_only=given.trained)
        if found is not None:
            File(path).write_text(json.dumps(found, indent=1) + "\n")
            print(f"{asked.name}: p {found['receipt']['p']:.3f}", flush=True)


if __name__ == "__main__":
    main()
