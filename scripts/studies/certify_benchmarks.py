"""Certify the environments of docs/studies/benchmarks.md, one after another, and keep each result.

    python scripts/studies/certify_benchmarks.py --list
    export OMP_NUM_THREADS=1 PYTHONHASHSEED=0
    nice -n 19 python scripts/studies/certify_benchmarks.py
    nice -n 19 python scripts/studies/certify_benchmarks.py DoorKey BabyAI

The last line certifies only the environments whose name contains one of the texts. An environment
is left out if its certificate is kept or its package is not installed. `seconds.csv` receives the
processor time of each. `--records FOLDER` certifies what `record_procgen.py` recorded. Levels of
VAGEN's Sokoban depend on PYTHONHASHSEED, which their certificate names.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from environments.elsewhere import lake_of, maze_of, room_of
from environments.generated import TEST, map_of

from labyrinth_core import certify
from labyrinth_core.benchmarks import Certificate, CertifyError

KEPT = Path(__file__).parents[2] / "docs/results/benchmarks"
SECONDS = "seconds.csv"
"""The log: the name of each certificate and its processor time in seconds."""

GENERATED = "environments.generated:"
"""The module of environments in which a seed chooses the level."""
ELSEWHERE = "environments.elsewhere:"
"""The module of environments with an interface of their own."""

MINIGRID = (
    *("DoorKey-5x5", "DoorKey-8x8", "LavaCrossingS9N2", "MultiRoom-N2-S4", "FourRooms"),
    *("KeyCorridorS3R1", "Fetch-8x8-N3", "SimpleCrossingS9N1", "DoorKey-6x6", "Unlock"),
    *("Empty-Random-6x6", "GoToDoor-5x5", "PutNear-6x6-N2", "KeyCorridorS6R3"),
    *("ObstructedMaze-1Dl", "MultiRoom-N6"),
)
BABYAI = ("GoToLocal", "GoToRedBall", "BossLevel")
CONTROL = ("CartPole-v1", "MountainCar-v0", "Acrobot-v1", "Pendulum-v1")
LABYRINTHS = tuple(f"{name}{n}x{n}" for n in (3, 4, 5) for name in ("Labyrinth", "TwoSplits"))


@dataclass(frozen=True)
class Benchmark:
    """An environment to certify."""

    environment: str
    """What `certify` takes."""
    package: str
    """The package that has to be installed."""
    train: range = range(500)
    test: range = range(TEST, TEST + 500)
    probes: int = 4
    steps: int = 64
    state: Callable[[Any], Any] | None = None
    """The state function, if `certify` does not know it."""

    @property
    def name(self) -> str:
        """The name of the certificate's file, without its end."""
        return self.environment.rpartition(":")[2]


def benchmarks() -> Iterator[Benchmark]:
    """Yield all environments, the fastest of each package first."""
    for name in CONTROL:
        yield Benchmark(name, "gymnasium")
    for size in ("4x4", "8x8"):
        yield Benchmark(f"{GENERATED}FrozenLake{size}-v0", "gymnasium", state=map_of)
    for name in LABYRINTHS:
        yield Benchmark(f"{GENERATED}{name}-v0", "gymnasium")
    for name in MINIGRID:
        yield Benchmark(f"MiniGrid-{name}-v0", "minigrid")
    for name in BABYAI:
        yield Benchmark(f"BabyAI-{name}-v0", "minigrid")
    for name in ("Explore", "Escape"):
        name = f"popgym:popgym-Labyrinth{name}Easy-v0"
        yield Benchmark(name, "popgym", state=maze_of)
    yield Benchmark(f"{ELSEWHERE}OpenEnv-Maze-v0", "maze_env")
    yield Benchmark(f"{ELSEWHERE}ReasoningGym-Maze-v0", "reasoning_gym", probes=1, steps=1)
    yield Benchmark(f"{ELSEWHERE}Jumanji-Maze-v0", "jumanji", probes=1, steps=8)
    # The seeds are those of VAGEN's examples/train, and of RAGEN's config/base.yaml: 8 new ones
    # in each of 200 training steps, and 512 for validation.
    for name, state in (("FrozenLake", lake_of), ("Sokoban", room_of)):
        for package, train, test in (
            ("VAGEN", range(1, 10_001), range(10_001, 10_257)),
            ("RAGEN", range(10_000, 11_600), range(123, 635)),
        ):
            name_of = f"{ELSEWHERE}{package}-{name}-v0"
            yield Benchmark(name_of, package.lower(), train, test, 1, 8, state)
    crafter = range(25), range(TEST, TEST + 25)
    yield Benchmark(f"{GENERATED}Crafter-v0", "crafter", *crafter, probes=1)


def missing_in(folder: Path) -> list[Benchmark]:
    """Return the environments whose certificate is not in a folder."""
    return [each for each in benchmarks() if not (folder / f"{each.name}.json").exists()]


def main() -> None:
    """Certify what is missing, or list it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", nargs="*", help="only names that contain this, such as DoorKey")
    parser.add_argument("--kept", type=Path, default=KEPT, help="folder for the certificates")
    parser.add_argument("--records", type=Path, help="only certify the records in this folder")
    parser.add_argument("--list", action="store_true", help="only list what is missing")
    given = parser.parse_args()
    if given.records is not None:
        for path in sorted(given.records.glob("*.jsonl")):
            if not (target := given.kept / f"{path.stem}.json").exists():
                keep(certify(path), target)
        return
    for each in missing_in(given.kept):
        if given.part and not any(part in each.name for part in given.part):
            continue
        if find_spec(each.package) is None:
            print(f"{each.name}: left out, {each.package} is not installed", flush=True)
        elif given.list:
            print(each.name)
        else:
            perform(each, given.kept)


def perform(benchmark: Benchmark, folder: Path) -> None:
    """Certify an environment, and log the time; an error stops no other environment."""
    began = time.process_time()
    try:
        certificate = certify(
            benchmark.environment,
            train=benchmark.train,
            test=benchmark.test,
            probes=benchmark.probes,
            steps=benchmark.steps,
            state=benchmark.state,
        )
    except CertifyError as error:
        print(f"{benchmark.name}: {error}", flush=True)
        return
    keep(certificate, folder / f"{benchmark.name}.json")
    with (folder / SECONDS).open("a", encoding="utf-8") as log:
        log.write(f"{benchmark.name},{time.process_time() - began:.0f}\n")


def keep(certificate: Certificate, target: Path) -> None:
    """Print a certificate and write it to a file."""
    print(f"{certificate}\n", flush=True)
    target.parent.mkdir(parents=True, exist_ok=True)
    certificate.save(target)


if __name__ == "__main__":
    main()
