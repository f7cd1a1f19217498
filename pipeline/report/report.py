"""The report on a folder of datasets: one HTML file that works offline.

The page is assembled from the files in `page/` and the data. It draws every picture itself and
makes no network request, which its content security policy forbids.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from typing import Any

from labyrinth_core.evaluation import Results
from labyrinth_core.language import SETTINGS_OF
from labyrinth_core.pictures import DEFAULT_STYLE
from labyrinth_core.version import __version__
from labyrinth_core.world import Task
from pipeline.config import Job
from pipeline.inspection import DatasetStatistics, statistics_of
from pipeline.machinery import leave, say, within
from pipeline.report.findings import read_results
from pipeline.report.options import ReportOptions
from pipeline.report.packing import PackedSplit, pack

FOLDER = "report"
"""The folder of the report in the data_dir; it is not published with the dataset."""
PAGE = "index.html"

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
