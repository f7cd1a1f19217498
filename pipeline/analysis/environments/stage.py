"""The stage `environments`: how much the episodes of an environment differ, beside labyrinths'.

An expert plays each environment from many seeds. The episodes of even and of odd seeds are two
samples that a benchmark might take to train and to evaluate on; what tells them apart is measured.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rich.table import Table

from labyrinth_core import __version__
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.storage import file_sha256, write_text
from pipeline.analysis.environments.environment import World, world_of
from pipeline.analysis.environments.experts import source_of
from pipeline.analysis.environments.frames import Frame
from pipeline.analysis.environments.summaries import Summary
from pipeline.analysis.environments.variation import Variation, corrected, measure
from pipeline.analysis.environments.variation_report import check_can_draw, write_report
from pipeline.config.analysis import LABYRINTH
from pipeline.config.run import Run
from pipeline.machinery.console import console, tracked
from pipeline.machinery.executor import ordered_map

CHUNK = 100
"""Seeds whose episodes are played and kept together."""
PILOTS = 32
"""Episodes, of the first seeds, that say where the others are measured."""

_MADE_OF = "made-of.json"


@dataclass(frozen=True)
class Job:
    """A chunk of seeds to play, in this process or another."""

    name: str
    dataset: DatasetConfig
    archive: str | None
    frame: Frame
    seeds: range
    path: Path


def run(run: Run) -> None:
    """Compare the environments of a run.

    Raises:
        ConfigError: A library is missing.
        DatasetError: An expert's archive cannot be read.
        OSError: The folder cannot be written.
    """
    options = run.options.analysis
    folder = Path(options.folder).expanduser()
    check_can_draw()
    # Of all environments first: what is missing is said before hours of playing.
    frames = {name: _frame(run, folder, name) for name in options.environments}
    results, maps = [], {}
    for name, frame in frames.items():
        started = time.perf_counter()
        summary = _played(run, folder, name, frame)
        results.append(measure(name, frame, summary, run.dataset.seed))
        maps[name] = frame, summary.visits
        seconds = time.perf_counter() - started
        console.print(
            f"{name}: {results[-1].seeds:,} episodes, {results[-1].steps:,} steps, {seconds:.0f} s",
            highlight=False,
        )
    results = corrected(results)
    write_report(folder, results, maps)
    console.print(_summary(results))
    console.print(f"{folder} has the tables and pictures.", soft_wrap=True)


def _frame(run: Run, folder: Path, name: str) -> Frame:
    """Return what episodes are measured on; episodes of other origin are removed."""
    archive = run.options.analysis.archives.get(name)
    folder = folder / "episodes" / name
    made_of = _made_of(name, run.dataset, archive)
    try:
        kept = json.loads((folder / _MADE_OF).read_bytes())
        if kept["made_of"] == made_of:
            return Frame.from_json(kept["frame"])
    except (FileNotFoundError, ValueError, LookupError, TypeError):
        pass
    world = _world(name, run.dataset, archive)
    frame = Frame.around(world, map(world.play, range(PILOTS)))
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    write_text(folder / _MADE_OF, json.dumps({"made_of": made_of, "frame": frame.to_json()}))
    return frame


def _played(run: Run, folder: Path, name: str, frame: Frame) -> Summary:
    """Return all episodes of an environment; what earlier runs have finished is not played."""
    options = run.options.analysis
    archive = options.archives.get(name)
    folder = folder / "episodes" / name
    jobs = [
        Job(name, run.dataset, archive, frame, seeds, folder / f"{seeds.start}-{seeds.stop}.npz")
        for seeds in _chunks(options.seeds)
    ]
    played = ordered_map(summarise, jobs, run.options.workers)
    sized = ((len(job.seeds), summary) for job, summary in zip(jobs, played, strict=True))
    return Summary.joined(list(tracked(sized, name, total=options.seeds)))


def _chunks(seeds: int) -> Iterator[range]:
    for first in range(0, seeds, CHUNK):
        yield range(first, min(first + CHUNK, seeds))


def _made_of(name: str, dataset: DatasetConfig, archive: str | None) -> dict[str, Any]:
    """Return all that settles what the episodes of an environment are, in plain types."""
    if name == LABYRINTH:
        kept = ("height", "width", "task", "sampler", "open_walls")
        values = dataset.to_json()
        expert = {key: values[key] for key in kept}
    else:
        expert = {"expert": file_sha256(source_of(name, archive))}
    libraries = ("numpy", "gymnasium", "mujoco")
    return expert | {"labyrinth-datasets": __version__} | {key: _version(key) for key in libraries}


def _version(library: str) -> str | None:
    try:
        return version(library)
    except PackageNotFoundError:
        return None


@lru_cache(maxsize=1)
def _world(name: str, dataset: DatasetConfig, archive: str | None) -> World:
    return world_of(name, dataset, archive)


def summarise(job: Job) -> Summary:
    """Play the seeds of a job, or return what an earlier run has kept of them."""
    summary = Summary.load(job.path)
    if summary is None:
        world = _world(job.name, job.dataset, job.archive)
        summary = Summary.of(world, job.frame, job.seeds)
        summary.save(job.path)
    return summary


def _summary(results: list[Variation]) -> Table:
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
