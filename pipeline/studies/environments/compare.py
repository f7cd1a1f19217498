"""The stage `environments`: how much episodes vary, in labyrinths and in other environments.

An expert plays each environment from many seeds. The episodes of even and of odd seeds are two
samples on which a benchmark might train and evaluate; the differences between them are measured.
"""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import dataclass, replace
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rich.table import Table

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.storage import file_sha256
from labyrinth_core.version import __version__
from pipeline.config.analysis import LABYRINTH
from pipeline.config.run import Run
from pipeline.machinery.console import console, tracked
from pipeline.machinery.executor import ordered_map
from pipeline.studies.environments.discretisation import Discretisation
from pipeline.studies.environments.environment import environment_of
from pipeline.studies.environments.experts import source_of
from pipeline.studies.environments.summaries import Summary
from pipeline.studies.environments.variation import Variation, corrected, measure
from pipeline.studies.environments.variation_report import check_can_draw, write_report

CHUNK = 100
"""The number of seeds whose episodes are played and kept together."""
PILOTS = 32
"""The number of episodes from which the discretisation is made."""


@dataclass(frozen=True)
class Job:
    """Seeds of an environment to play, in this process or another."""

    name: str
    dataset: DatasetConfig
    archive: str | None
    discretisation: Discretisation
    folder: Path
    seeds: range


def run(run: Run, *, chunk: int = CHUNK, pilots: int = PILOTS) -> None:
    """Compare the environments of a run.

    Raises:
        ConfigError: A library is missing.
        DatasetError: An expert's archive cannot be read.
        OSError: The folder cannot be written.
    """
    options = run.options.analysis
    folder = Path(options.folder).expanduser()
    check_can_draw()
    # All environments before any is played: what is missing is reported before hours of playing.
    jobs = [_job(run, name, pilots) for name in options.environments]
    results, maps = [], {}
    for job in jobs:
        started = time.perf_counter()
        parts = [
            replace(job, seeds=job.seeds[first : first + chunk])
            for first in range(0, len(job.seeds), chunk)
        ]
        played = ordered_map(summarise, parts, run.options.workers)
        sized = ((len(part.seeds), each) for part, each in zip(parts, played, strict=True))
        summary = Summary.joined(list(tracked(sized, job.name, total=len(job.seeds))))
        results.append(measure(job.name, job.discretisation, summary, run.dataset.seed))
        maps[job.name] = job.discretisation, summary.visits
        console.print(
            f"{job.name}: {results[-1].seeds:,} episodes, {results[-1].steps:,} steps, "
            f"{time.perf_counter() - started:.0f} s",
            highlight=False,
        )
    results = corrected(results)
    write_report(folder, results, maps)
    console.print(_table(results))
    console.print(f"{folder} has the tables and pictures.", soft_wrap=True)


def _job(run: Run, name: str, pilots: int) -> Job:
    """Return all seeds of an environment as a job; its folder is that of these options."""
    options = run.options.analysis
    archive = options.archives.get(name)
    environment = environment_of(name, run.dataset, archive)
    discretisation = Discretisation.around(environment, map(environment.play, range(pilots)))
    made_of = _made_of(name, run.dataset, archive) | {"points": discretisation.fingerprint}
    digest = hashlib.sha256(json.dumps(made_of).encode()).hexdigest()
    folder = Path(options.folder).expanduser() / "episodes" / f"{name}-{digest[:16]}"
    folder.mkdir(parents=True, exist_ok=True)
    return Job(name, run.dataset, archive, discretisation, folder, range(options.seeds))


def _made_of(environment: str, dataset: DatasetConfig, archive: str | None) -> dict[str, Any]:
    """Return everything that determines the episodes of an environment, in plain types."""
    if environment == LABYRINTH:
        values = dataset.to_json()
        made_of = {key: values[key] for key in ("height", "width", "task", "sampler", "open_walls")}
    else:
        made_of = {"expert": file_sha256(source_of(environment, archive))}
    made_of["labyrinth-datasets"] = __version__
    libraries = ("numpy", "gymnasium", "mujoco")
    return made_of | {name: version(name) if find_spec(name) else None for name in libraries}


def summarise(job: Job) -> Summary:
    """Play the seeds of a job, unless an earlier run has kept their summary."""
    path = job.folder / f"{job.seeds.start}-{job.seeds.stop}.npz"
    summary = Summary.load(path)
    if summary is None:
        environment = environment_of(job.name, job.dataset, job.archive)
        summary = Summary.of(environment, job.discretisation, job.seeds)
        summary.save(path)
    return summary


def _table(results: list[Variation]) -> Table:
    """Return the table that a person sees at the end."""
    table = Table(title=f"episodes of even and of odd seeds, {results[0].seeds:,} together")
    table.add_column("environment")
    for heading in ("reward", "actions", "states", "p", "Holm", "effect"):
        table.add_column(heading, justify="right")
    for each in results:
        states = each.states
        numbers = (each.actions.distance, states.distance, states.p_value, states.holm)
        shown = [f"{number:.4f}" for number in (*numbers, states.effect)]
        table.add_row(each.name, f"{each.average_reward:,.2f}", *shown)
    return table
