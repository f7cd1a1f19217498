"""Run what the pages of docs/studies still miss, one run after another, and keep each result.

    python scripts/studies/run_queue.py --list
    OMP_NUM_THREADS=1 nohup nice -n 19 python scripts/studies/run_queue.py --kept FOLDER &
    OMP_NUM_THREADS=1 nohup nice -n 19 python scripts/studies/run_queue.py authors/ --kept FOLDER &

The last line begins a queue of some of the runs, for a second core.
Results lie in FOLDER as in docs/results, with the hours of each run in `hours.csv`. A run that is
kept in either is not repeated; one that was killed goes on from its checkpoint. `report_pages.py`
says what is missing.
"""

from __future__ import annotations

import argparse
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from labyrinth_core.evaluation import RunName

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs/results"
HOURS = "hours.csv"
"""The log, in the folder of the results: the path of each result, its hours of processor time and
on the clock; several lines if the queue was ended meanwhile."""

LONGEST = 2.0
"""The hours of the longest run that the queue takes on; of longer ones the page gives the hours."""

SIX = ("bc", "dagger", "gail", "bco", "sqil", "iupe")
THOUSAND = "size=5 labyrinths=1000 data_dir=data/thousand"
"""What most runs are evaluated on, as options of its build."""

RESNET = {1: 11.0, 2: 11.0}
"""Seeds of GAIL with ResNet-18 at 5x5, and the hours of each without a GPU, estimated."""

AUTHORS = {
    "3x3": {"bc": (1000, 0.02), "dagger": (200, 0.2), "bco": (400, 1.3), "iupe": (100, 0.1)},
    "5x5": {"dagger": (150, 0.3), "bco": (100, 0.4), "iupe": (100, 0.4)},
    "4x4": {"iupe": (50, 0.2), "dagger": (150, 0.5), "bco": (100, 0.5)},
}
"""Epochs and hours of each method by the authors' protocol with batches of 8."""

SEEDS = {"bc": 0.01, "dagger": 0.02, "iupe": 0.04, "sqil": 0.06, "bco": 0.05, "gail": 0.07}
"""Hours of each method at 5x5 with one more seed, and its evaluation on a thousand labyrinths."""

SCALING = "scaling"
"""The folder of the runs of docs/studies/scaling.md."""

GOALS = {
    "fixed": ("size=5 labyrinths={} data_dir=data/many", THOUSAND),
    "varied": (
        "size=5 goals=varied labyrinths={} data_dir=data/many_varied",
        "size=5 goals=varied labyrinths=1000 data_dir=data/thousand_varied",
    ),
}
"""`goals` -> what the runs of SCALING learn from, of some number of labyrinths, and are evaluated
on."""

MANY = 10_000
"""The labyrinths of train in most runs of SCALING, and of an epoch of FRESH ones."""

STEPS = {2_800: 2, 50_000: 36}
"""The gradient steps of a run of SCALING, about -> how often it sees a step of MANY labyrinths."""

POINTS: tuple[int | str, ...] = (100, 1_000, MANY, RunName.FRESH, 300, 3_000)
"""The numbers of labyrinths that BC learns from in SCALING, those first that say most."""


@dataclass(frozen=True)
class Planned:
    """A run of the queue."""

    kept: str
    """Where its results lie in docs/results."""
    hours: float
    """What it takes on one core, estimated."""
    dataset: str
    """The options of what it learns from."""
    options: str
    """The others of training and evaluation."""
    evaluated: str = ""
    """The options of what it is evaluated on, if that is another dataset."""

    @property
    def evaluate_on(self) -> str:
        """The other dataset that it is evaluated on, if any."""
        return f"{self.evaluated.rpartition('=')[2]}/5x5" if self.evaluated else ""

    @property
    def folder(self) -> str:
        """The folder of the results."""
        return Path(self.kept).parent.as_posix()

    @property
    def found(self) -> str:
        """A pattern of what the stage `evaluate` leaves, from `runs` on."""
        results = "results-*.json" if self.evaluate_on else "results.json"
        return f"{self.kept.removesuffix('.json')}/{results}"

    def commands(self) -> Iterator[str]:
        """Yield the commands that make it, each a program and its options, from its datasets on."""
        for each in filter(None, (self.dataset, self.evaluated)):
            yield f"run.py {each} stages=build"
        own = f"{self.dataset} {self.options} threads=1"
        own += f" run_dir={Path('runs', self.kept).parents[1]}"
        elsewhere = f" evaluate_on={self.evaluate_on}" * bool(self.evaluate_on)
        yield f"run.py {own} stages=train"
        yield f"run.py {own} stages=evaluate{elsewhere}"
        if "protocol=authors" in self.options:
            folder = Path("runs", self.kept).with_suffix("")
            yield f"scripts/studies/try_authors.py {folder} data/labyrinth/{folder.parent.name}"


def planned() -> Iterator[Planned]:
    """Yield all runs: ResNet-18, the authors' protocol, more seeds, more labyrinths."""
    for seed, hours in RESNET.items():
        given = f"method=gail encoder=resnet18 seed={seed} method.evaluate_every=5"
        yield Planned(f"runs/5x5/gail-resnet18-seed{seed}.json", hours, "size=5", given)
    for config, chosen in AUTHORS.items():
        for method, (epochs, hours) in chosen.items():
            given = "method=custom protocol=authors"
            given += f" method._target_=scripts.studies.methods.authors.{method}.Method"
            given += f" method.epochs={epochs} method.batch_size=8"
            name = f"authors/runs/{config}/{method}-cnn-seed0-authors.json"
            if method not in ("bco", "iupe"):  # These explore whenever they are tried.
                given += f" method.evaluate_every={epochs // 5}"
            yield Planned(name, hours, f"size={config[0]}", given)
    for seed in range(5, 20):
        for method, hours in SEEDS.items():
            name = f"thousand/runs/5x5/{method}-cnn-seed{seed}.json"
            given = f"method={method} seed={seed}"
            shifts = "size=5 shifts=all data_dir=data/shifts"
            yield Planned(name, hours, shifts, given, THOUSAND)
    yield from scaling()


def scaling() -> Iterator[Planned]:
    """Yield the runs of docs/studies/scaling.md, the shorter ones first."""
    for steps in STEPS:
        for goals in GOALS:
            for labyrinths in POINTS:
                yield scaled("bc", goals, labyrinths, steps, 0)
        for method in ("dagger", "iupe"):
            for labyrinths in POINTS[:4]:
                yield scaled(method, "fixed", labyrinths, steps, 0)
        for seed in (1, 2):
            for goals in GOALS:
                for labyrinths in POINTS:
                    yield scaled("bc", goals, labyrinths, steps, seed)
    yield scaled("bc", "fixed", 10 * MANY, 50_000, 0)
    for labyrinths in POINTS[:3]:
        yield scaled("gail", "fixed", labyrinths, 50_000, 0)


def scaled(method: str, goals: str, labyrinths: int | str, steps: int, seed: int) -> Planned:
    """Return a run that learns from some labyrinths, or from fresh ones, with about `steps` steps.

    BC, DAgger and IUPE take a gradient step for each 64 demonstrated steps of an epoch; GAIL has
    its usual epochs, which are longer for more labyrinths.
    """
    learnt = labyrinths if isinstance(labyrinths, int) else MANY
    epochs = 100 if method == "gail" else round(STEPS[steps] * MANY / learnt)
    given = f"method={method} seed={seed} train_labyrinths={labyrinths} method.epochs={epochs}"
    given += f" method.evaluate_every={max(1, epochs // 3)}"
    data, evaluated = GOALS[goals]
    name = RunName(
        method=method, encoder="cnn", protocol="default", train_labyrinths=labyrinths, seed=seed
    ).name
    times = {"bc": 1.0, "dagger": 2.0, "iupe": 3.0, "gail": learnt / 1_000}[method]
    hours = times * (0.02 + steps / 120_000)
    kept = f"{SCALING}/{goals}-{steps}/runs/5x5/{name}.json"
    return Planned(kept, round(hours, 2), data.format(max(learnt, MANY)), given, evaluated)


def missing_in(*folders: Path) -> list[Planned]:
    """Return the runs that none of some folders of results holds."""
    return [each for each in planned() if not any((one / each.kept).exists() for one in folders)]


def main() -> None:
    """Run what is missing, or list all runs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", nargs="*", help="only runs whose path holds this, such as seed7")
    parser.add_argument("--kept", type=Path, default=RESULTS, help="where to keep the results")
    parser.add_argument("--list", action="store_true", help="only list the runs and their hours")
    given = parser.parse_args()
    kept = given.kept.resolve()
    missing = missing_in(RESULTS, kept)
    if given.part:
        missing = [each for each in missing if any(part in each.kept for part in given.part)]
    if given.list:
        for each in missing:
            print(f"{each.hours:5.2f} h{' (left out)' * (each.hours > LONGEST)}  {each.kept}")
        return
    kept.mkdir(parents=True, exist_ok=True)
    # `subprocess.run` then kills what it waits for; a checkpoint is half a minute old at most.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    for each in missing:
        if each.hours <= LONGEST:
            perform(each, kept)


def perform(run: Planned, kept: Path) -> None:
    """Train and evaluate, and keep the results and the hours; an error stops no other run."""
    before, began = processor_seconds(), time.time()
    print(f"{time.strftime('%d %b %H:%M:%S')}  {run.kept}", flush=True)
    try:
        for command in run.commands():
            program(command)
        keep(run, kept)
    except subprocess.CalledProcessError as error:
        print(f"failed: {error}", flush=True)
    finally:
        spent = (processor_seconds() - before, time.time() - began)
        with (kept / HOURS).open("a", encoding="utf-8") as log:
            log.write(",".join([run.kept, *(f"{each / 3600:.3f}" for each in spent)]) + "\n")


def keep(run: Planned, kept: Path) -> None:
    """Copy the results of a run that was evaluated to where they are kept."""
    (found,) = (ROOT / "runs").glob(run.found)
    target = kept / run.kept
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(found, target.with_suffix(".part"))
    target.with_suffix(".part").replace(target)


def processor_seconds() -> float:
    """Return the processor time of all programs that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def program(command: str) -> None:
    """Run a program with options, in the folder of the project."""
    subprocess.run([sys.executable, *shlex.split(command)], cwd=ROOT, check=True)


if __name__ == "__main__":
    main()
