"""The report on a folder of datasets: one HTML file that works offline.

The page is assembled from the files in `page/` and the data. It draws every picture itself and
makes no network request, which its content security policy forbids. A labyrinth takes a few numbers
and two bit sets of passages, an episode two bits per action.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from labyrinth_core.data import Dataset, ShardFile
from labyrinth_core.evaluation import Results
from labyrinth_core.language import SETTINGS_OF, labyrinth_id
from labyrinth_core.pictures import DEFAULT_STYLE
from labyrinth_core.version import __version__
from labyrinth_core.world import Labyrinth, Task
from pipeline.config import Job
from pipeline.inspection import DatasetStatistics, Route, SplitCounts, routes_of, statistics_of
from pipeline.machinery import leave, ordered_map, say, within
from pipeline.report.findings import read_results
from pipeline.report.options import ReportOptions

FOLDER = "report"
"""The folder of the report in the data_dir; it is not published with the dataset."""
PAGE = "index.html"

_NUMBER_BYTES = 4
"""The bytes counted per number; the page uses as few as the largest of the column needs."""
PACKED_BYTES = 36_000_000
"""The maximum number of bytes of packed labyrinths and episodes; 48 MB in the page, as base64."""

SCRIPTS = (
    "world",
    "language",
    "dom",
    "drawing",
    "records",
    "gallery",
    "player",
    "receipts",
    "findings",
    "figures",
    "main",
)
"""The parts of the page's JavaScript, each after the parts that it uses."""


def run(job: Job[ReportOptions]) -> None:
    """Write the report on the data_dir of a run.

    Raises:
        DatasetError: As for `write_report`.
        OSError: The folder cannot be written.
    """
    run_dir, results_dir = (
        Path(folder).expanduser() for folder in (job.options.run_dir, job.options.results_dir)
    )
    workers, overwrite = job.options.workers, job.options.overwrite
    page = write_report(job.local_dir, run_dir, results_dir, workers=workers, overwrite=overwrite)
    megabytes = page.stat().st_size / 1e6
    say(f"{page} ({megabytes:.1f} MB) opens in any browser.")


def write_report(
    data_dir: Path,
    run_dir: Path,
    results_dir: Path | None = None,
    *,
    workers: int = 1,
    overwrite: bool = False,
) -> Path:
    """Write the report on all finished datasets of a folder, and return its page.

    Args:
        data_dir: The folder.
        run_dir: The folder of the runs trained on them; it need not exist.
        results_dir: The folder with submitted results, if any.
        workers: The number of processes that read shards.
        overwrite: Whether to replace a page that someone else made or changed.

    Raises:
        DatasetError: There is no dataset; a dataset, its analysis or an evaluation is damaged;
            someone else made or changed the page; or its folder is a link.
        OSError: The folder cannot be written.
    """
    found = statistics_of(data_dir, "report", workers)
    limit = PACKED_BYTES // sum(len(of.splits) for of in found)
    datasets = []
    for of in found:
        packed = {split: pack(of.data, split, limit, workers) for split in of.splits}
        datasets.append(describe(of, packed, limit))
    html = page(datasets, read_results(run_dir, [of.data for of in found], results_dir))
    folder = within(data_dir, FOLDER)
    leave(folder, {PAGE: html.encode()}, overwrite=overwrite)
    return folder / PAGE


def describe(
    dataset: DatasetStatistics, splits: Mapping[str, PackedSplit], limit: int
) -> dict[str, Any]:
    """Return the page's data on a dataset.

    Args:
        dataset: The counts and the analysis.
        splits: The labyrinths and episodes of each split.
        limit: About how many bytes of labyrinths and episodes to keep per split.
    """
    config = dataset.manifest.config
    return {
        "name": config.name,
        "height": config.height,
        "width": config.width,
        "task": str(config.task),
        "seed": config.seed,
        "splits": [
            {"name": name} | split.to_json(dataset.splits[name], limit)
            for name, split in splits.items()
        ],
        "analysis": dataset.analysis,
    }


def page(datasets: Sequence[Mapping[str, Any]], results: Sequence[Mapping[str, Any]] = ()) -> str:
    """Return the HTML of the page.

    Args:
        datasets: The results of `describe`.
        results: The result of `findings.read_results`.
    """
    data = {
        "version": __version__,
        "colours": asdict(DEFAULT_STYLE),
        "tasks": {str(task): _described(task) for task in Task},
        "datasets": datasets,
        "results": results,
        "whySpl": " ".join(Results.WHY_SPL.split()),
    }
    style, script = _source("style.css"), "\n".join(_source(f"{name}.js") for name in SCRIPTS)
    policy = (
        "default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'; "
        f"style-src '{_hash(style)}'; script-src '{_hash(script)}'"
    )
    html = _source("index.html")
    # The data comes last, so that no name in braces in it is filled in.
    for name, text in {"policy": policy, "style": style, "script": script}.items():
        html = html.replace(f"{{{{{name}}}}}", text)
    # A NaN is not JSON: the browser would not read any of the data.
    plain = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return html.replace("{{data}}", plain)


def _described(task: Task) -> dict[str, Any]:
    """Return what the page needs to know about a task."""
    return {
        "settings": SETTINGS_OF[task],
        "phases": task.rules.phases,
        "hides": task.rules.hides,
        "tiles": [tile._asdict() for tile in task.rules.tiles],
    }


def _source(name: str) -> str:
    return files("pipeline.report").joinpath(f"page/{name}").read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """Return the hash of a text in the form of a content security policy."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


@dataclass
class PackedSplit:
    """Labyrinths with their episodes, in order."""

    fixed: dict[str, bytearray] = field(default_factory=lambda: defaultdict(bytearray))
    """Columns with the same number of bytes for each labyrinth."""
    numbers: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    """Columns with one number per labyrinth; `length` has one per episode."""
    actions: bytearray = field(default_factory=bytearray)
    """The actions of all episodes, one after the other."""

    @property
    def size(self) -> int:
        """The maximum number of bytes that the split takes in the page, before base64."""
        numbers = sum(map(len, self.numbers.values()))
        fixed = sum(map(len, self.fixed.values()))
        return fixed + _NUMBER_BYTES * numbers + len(self.actions) // 4

    def add(self, route: Route) -> None:
        """Add an episode; episodes must be grouped by labyrinth."""
        if route.is_first:
            self._add_labyrinth(route.labyrinth, route.solver.moves)
        self.numbers["episodes"][-1] += 1
        self.numbers["length"].append(len(route.actions))
        self.actions.extend(route.actions)

    def extend(self, other: PackedSplit) -> None:
        """Add the next shard."""
        for name, column in other.fixed.items():
            self.fixed[name] += column
        for name, values in other.numbers.items():
            self.numbers[name] += values
        self.actions.extend(other.actions)

    def _add_labyrinth(self, labyrinth: Labyrinth, shortest: int) -> None:
        structure = labyrinth.structure
        wide = (structure.cells + 7) // 8
        self.fixed["id"] += bytes.fromhex(labyrinth_id(labyrinth))
        self.fixed["structure"] += bytes.fromhex(structure.structure_id)
        self.fixed["up"] += structure.up.to_bytes(wide, "little")
        self.fixed["right"] += structure.right.to_bytes(wide, "little")
        rules = labyrinth.task.rules
        for name in rules.grounds:
            cells = sum(1 << cell for cell in getattr(labyrinth, name))
            self.fixed[name] += cells.to_bytes(wide, "little")
        numbers = {"start": labyrinth.start, "goal": labyrinth.goal, "moves": shortest}
        numbers |= {"loops": structure.loops, "episodes": 0}
        numbers |= {name: getattr(labyrinth, name) for name in rules.singles}
        for name, number in numbers.items():
            self.numbers[name].append(number)

    def to_json(self, counts: SplitCounts, limit: int) -> dict[str, Any]:
        """Return the counts of all labyrinths, and the first ones that fit in `limit` bytes."""
        episodes = np.cumsum(self.numbers["episodes"])
        lengths = np.concatenate([[0], np.cumsum(self.numbers["length"])])
        of_each = sum(map(len, self.fixed.values())) // len(episodes)
        of_each += _NUMBER_BYTES * (len(self.numbers) - 1)
        taken = of_each * np.arange(1, len(episodes) + 1)
        taken = taken + _NUMBER_BYTES * episodes + lengths[episodes] // 4
        shown = int(np.searchsorted(taken, limit, side="right"))
        kept = int(episodes[shown - 1]) if shown else 0
        columns = {
            name: _base64(column[: shown * len(column) // len(episodes)])
            for name, column in self.fixed.items()
        }
        for name, values in self.numbers.items():
            columns[name] = _packed(values[: kept if name == "length" else shown])
        columns["actions"] = _base64(_quarters(self.actions[: lengths[kept]]))
        return {
            "labyrinths": counts.labyrinths,
            "episodes": counts.episodes,
            "shown": shown,
            "moves": sorted(counts.moves.items()),
            "loops": sorted(counts.loops.items()),
            "junctions": sorted(counts.junctions.items()),
            "actions": counts.actions.tolist(),
            "visits": counts.visits.ravel().tolist(),
            "columns": columns,
        }


def _packed(values: Sequence[int]) -> dict[str, str]:
    kind = np.min_scalar_type(max(values, default=0))
    array = np.array(values, kind.newbyteorder("<"))
    return {"type": kind.name, "data": _base64(array.tobytes())["data"]}


def _base64(data: bytes | bytearray) -> dict[str, str]:
    return {"type": "bytes", "data": base64.b64encode(data).decode()}


def _quarters(actions: bytes | bytearray) -> bytes:
    """Return actions in two bits each, the first in the lowest bits of its byte."""
    column = np.frombuffer(actions, np.uint8)[:, None]
    bits = np.unpackbits(column, axis=1, count=2, bitorder="little")
    return np.packbits(bits, bitorder="little").tobytes()


def pack_routes(routes: Iterable[Route], limit: int) -> PackedSplit:
    """Return packed episodes of as many labyrinths as fit in about `limit` bytes.

    Args:
        routes: The episodes, grouped by labyrinth.
        limit: About how many bytes to pack; at least one labyrinth is packed.
    """
    packed = PackedSplit()
    for route in routes:
        if route.is_first and packed.size > limit:
            break
        packed.add(route)
    return packed


def _pack_shard(limit: int, file: ShardFile) -> PackedSplit:
    return pack_routes(routes_of(file), limit)


def pack(data: Dataset, split: str, limit: int, workers: int = 1) -> PackedSplit:
    """Return the first labyrinths of a split of a dataset, packed as by `pack_routes`.

    Raises:
        DatasetError: A shard is missing or damaged, or its rows do not form episodes.
    """
    packed = PackedSplit()
    for part in ordered_map(partial(_pack_shard, limit), data.files(split), workers):
        packed.extend(part)
        if packed.size > limit:
            break
    return packed
