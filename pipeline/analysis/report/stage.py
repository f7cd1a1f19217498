"""The report on a folder of datasets: one HTML file to look at, offline, and its figures.

The page is made of the files in `page/`, put into one, with the data beside them. It draws every
picture itself, and asks the network for nothing: its content security policy forbids it.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from labyrinth_core.data.columns import SPLITS
from labyrinth_core.data.storage import write_text
from labyrinth_core.pictures.renderer import DEFAULT_STYLE
from labyrinth_core.version import __version__
from pipeline.analysis.report.figures import FIGURES_FOLDER, draw_figures
from pipeline.analysis.report.findings import read_results
from pipeline.analysis.report.packing import PackedSplit, pack
from pipeline.config.run import Run
from pipeline.machinery.console import console, say
from pipeline.machinery.statistics import ACTION_COLOURS, DatasetStatistics, statistics_of

FOLDER = "report"
"""The folder of the report in the data_dir; it is not published."""
PAGE = "index.html"

PACKED_BYTES = 36_000_000
"""The most bytes of labyrinths and episodes of all datasets; 48 MB of the page, as base64."""

SCRIPTS = (
    "world",
    "language",
    "dom",
    "drawing",
    "records",
    "gallery",
    "player",
    "findings",
    "figures",
    "editor",
    "main",
)
"""The parts of the page's program, each after those that it uses."""


def run(run: Run) -> None:
    """Write the report on the data_dir of a run.

    Raises:
        DatasetError: There is no dataset, or one is damaged.
        OSError: The folder cannot be written.
    """
    run_dir = Path(run.options.run_dir).expanduser()
    page = write_report(run.local_dir, run_dir, workers=run.options.workers)
    megabytes = page.stat().st_size / 1e6
    say(f"{page} ({megabytes:.1f} MB) opens in any browser.")


def write_report(data_dir: Path, run_dir: Path, *, workers: int = 1) -> Path:
    """Write the report on all finished datasets of a folder, and return its page.

    Args:
        data_dir: The folder.
        run_dir: The folder of the runs trained on them; it need not exist.
        workers: The number of processes that read shards.

    Raises:
        DatasetError: There is no dataset, or one, or what was found out about it, is damaged.
        OSError: The folder cannot be written.
    """
    found = statistics_of(data_dir, "report", workers)
    limit = PACKED_BYTES // (len(found) * len(SPLITS))
    datasets = []
    for of in found:
        folder = data_dir / of.name
        packed = {split: pack(folder, of.manifest, split, limit, workers) for split in SPLITS}
        datasets.append(describe(of, packed, limit))
    folder = data_dir / FOLDER
    folder.mkdir(exist_ok=True)
    results = read_results(run_dir, [of.manifest for of in found])
    has_figures = draw_figures(datasets, results, folder)
    if not has_figures:
        console.print("No figures as files: pip install 'labyrinth-datasets[analysis]' for them.")
    write_text(folder / PAGE, page(datasets, results, FIGURES_FOLDER if has_figures else None))
    return folder / PAGE


def describe(
    dataset: DatasetStatistics, splits: Mapping[str, PackedSplit], limit: int
) -> dict[str, Any]:
    """Return the data of the page on a dataset.

    Args:
        dataset: Its counts and its analysis.
        splits: Its labyrinths and episodes.
        limit: About how many bytes of labyrinths and episodes of each split to tell.
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


def page(
    datasets: Sequence[Mapping[str, Any]],
    results: Sequence[Mapping[str, Any]] = (),
    figures: str | None = None,
) -> str:
    """Return the page.

    Args:
        datasets: As from `describe`.
        results: As from `findings.read_results`.
        figures: The folder with the figures as files, relative to the page.
    """
    data = {
        "version": __version__,
        "colours": asdict(DEFAULT_STYLE),
        "actionColours": list(ACTION_COLOURS.values()),
        "datasets": datasets,
        "results": results,
        "figures": figures,
    }
    style, script = _source("style.css"), "\n".join(_source(f"{name}.js") for name in SCRIPTS)
    policy = (
        "default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'; "
        f"style-src '{_hash(style)}'; script-src '{_hash(script)}'"
    )
    html = _source("index.html")
    # The data last: nothing in it is taken for a place to fill.
    for name, text in {"policy": policy, "style": style, "script": script}.items():
        html = html.replace(f"{{{{{name}}}}}", text)
    # What is no number in JSON would be the end of the whole page.
    plain = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return html.replace("{{data}}", plain)


@cache
def _source(name: str) -> str:
    return files("pipeline.analysis.report").joinpath(f"page/{name}").read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """Return the hash of a text in the form of a content security policy."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
