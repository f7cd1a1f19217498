"""Measure how much episodes vary, in labyrinths and in other environments.

    pip install matplotlib 'gymnasium[mujoco]'
    python scripts/studies/compare_environments.py --workers 2
    python scripts/studies/compare_environments.py --environments Labyrinth --seeds 100000

An expert plays each environment with many seeds. The episodes with even seeds and those with odd
seeds are two samples, on which a benchmark might train and evaluate; this script measures how they
differ (supplement, section 5). It writes to `--folder`: `environments.md`, `.csv` and `.json`, the
maps of visits `visits.png` and `visits.svg`, and summaries of the episodes, from which a later run
continues, also with more seeds. The original has 100,000 seeds.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from dataclasses import dataclass, replace
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from environments.environment import FACTS, LABYRINTH, environment_of
from environments.experts import source_of
from environments.summaries import Discretisation, Summary
from environments.variation import corrected, measure
from environments.variation_report import write_report

from labyrinth_core.data import DatasetConfig
from labyrinth_core.storage import File
from labyrinth_core.version import __version__
from pipeline.command.composed import DatasetOptions, dataset_config
from pipeline.machinery import ordered_map

CHUNK = 100
"""The number of seeds whose episodes are played and saved together."""
PILOTS = 32
"""The number of episodes from which the discretisation is derived."""


@dataclass(frozen=True)
class Job:
    """Seeds of an environment to play, in this process or in a worker."""

    name: str
    dataset: DatasetConfig
    discretisation: Discretisation
    folder: Path
    seeds: range


def compare(
    folder: Path,
    names: list[str],
    dataset: DatasetConfig,
    *,
    seeds: int,
    workers: int = 1,
    chunk: int = CHUNK,
    pilots: int = PILOTS,
) -> None:
    """Compare environments, and write the report.

    Args:
        folder: The folder of the report and of the saved summaries.
        names: Names in `FACTS`.
        dataset: Size, task and sampler of the labyrinths, and the seed of the permutations.
        seeds: The number of episodes of each environment.
        workers: The number of processes.
        chunk: The number of seeds that are saved together.
        pilots: The number of episodes from which the discretisation is derived.

    Raises:
        LabyrinthError: Labyrinths of this size cannot hold the task.
        ImportError: MuJoCo is missing.
        OSError: The folder cannot be written.
    """
    results, maps = [], {}
    for job in [job_of(folder, name, dataset, range(seeds), pilots) for name in names]:
        started = time.perf_counter()
        starts = range(0, seeds, chunk)
        parts = [replace(job, seeds=job.seeds[first : first + chunk]) for first in starts]
        summary = Summary.joined(list(ordered_map(summarise, parts, workers)))
        results.append(measure(job.name, job.discretisation, summary, dataset.seed))
        maps[job.name] = job.discretisation, summary.visits
        print(
            f"{job.name}: {seeds:,} episodes, {results[-1].steps:,} steps, "
            f"{time.perf_counter() - started:.0f} s",
            flush=True,
        )
    write_report(folder, corrected(results), maps)
    print((folder / "environments.md").read_text(encoding="utf-8"))


def job_of(folder: Path, name: str, dataset: DatasetConfig, seeds: range, pilots: int) -> Job:
    """Return a job for an environment; the name of its folder identifies the episodes."""
    environment = environment_of(name, dataset)
    discretisation = Discretisation.around(environment, map(environment.play, range(pilots)))
    made_of = _made_of(name, dataset) | {"points": discretisation.fingerprint}
    digest = hashlib.sha256(json.dumps(made_of).encode()).hexdigest()
    kept = folder / "episodes" / f"{name}-{digest[:16]}"
    kept.mkdir(parents=True, exist_ok=True)
    return Job(name, dataset, discretisation, kept, seeds)


def _made_of(environment: str, dataset: DatasetConfig) -> dict[str, Any]:
    """Return everything that determines the episodes of an environment, as plain types."""
    if environment == LABYRINTH:
        values = dataset.to_json()
        made_of = {key: values[key] for key in ("height", "width", "task", "sampler", "open_walls")}
    else:
        made_of = {"expert": File(source_of(environment)).sha256()}
    made_of["labyrinth-datasets"] = __version__
    libraries = ("numpy", "gymnasium", "mujoco")
    return made_of | {name: version(name) if find_spec(name) else None for name in libraries}


def summarise(job: Job) -> Summary:
    """Return the summary of a job's episodes; play them if no earlier run has saved it."""
    path = job.folder / f"{job.seeds.start}-{job.seeds.stop}.npz"
    summary = Summary.load(path)
    if summary is None:
        environment = environment_of(job.name, job.dataset)
        summary = Summary.of(environment, job.discretisation, job.seeds)
        summary.save(path)
    return summary


def main() -> None:
    """Compare the environments that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--environments", nargs="+", default=list(FACTS), choices=FACTS)
    parser.add_argument("--seeds", type=int, default=1_000, help="episodes of each environment")
    parser.add_argument("--size", default="5", help="size of labyrinths: 5 or 4x6")
    parser.add_argument("--task", default="navigation", help="task of labyrinths")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--folder", type=Path, default=Path("results/environments"))
    given = parser.parse_args()
    dataset = dataset_config(DatasetOptions(size=given.size, task=given.task))
    compare(given.folder, given.environments, dataset, seeds=given.seeds, workers=given.workers)


if __name__ == "__main__":
    main()
