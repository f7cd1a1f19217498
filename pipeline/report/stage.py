"""The report on a folder of datasets: one HTML file to look at, offline, and its figures.

The page is made of the files in `page/`, put into one, with the data beside them. It draws every
picture itself, and asks the network for nothing: its content security policy forbids it.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.pictures.renderer import DEFAULT_STYLE
from labyrinth_core.version import __version__
from pipeline.config.run import Run
from pipeline.inspection.statistics import ACTION_COLOURS, DatasetStatistics, statistics_of
from pipeline.machinery.console import console, say
from pipeline.machinery.locks import held
from pipeline.machinery.own_files import OwnFiles, write_list
from pipeline.report.figures import FIGURES_FOLDER, draw_figures, is_figure
from pipeline.report.findings import read_results
from pipeline.report.packing import PackedSplit, pack

FOLDER = "report"
"""The folder of the report in the data_dir; it is not published."""
PAGE = "index.html"

_TITLE = b'<link rel="icon" href="data:,">\n<title>Labyrinth report</title>'
"""What every page has, also of versions that left no list of their files."""

PACKED_BYTES = 36_000_000
"""The most bytes of labyrinths and episodes of all datasets; 48 MB of the page, as base64."""

SCRIPTS = (
    "world",
    "language",
    "dom",
    "drawing",
    "records",
    "gallery",
    "gif",
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
        DatasetError: There is no dataset, or one, or what was found out about it, is damaged; or
            a page of somebody else is in the place of the report.
        OSError: The folder cannot be written.
    """
    found = statistics_of(data_dir, "report", workers)
    limit = PACKED_BYTES // sum(len(of.splits) for of in found)
    datasets = []
    for of in found:
        folder = data_dir / of.name
        packed = {split: pack(folder, of.manifest, split, limit, workers) for split in of.splits}
        datasets.append(describe(of, packed, limit))
    results = read_results(run_dir, [of.manifest for of in found])
    figures = draw_figures(datasets, results)
    if figures is None:
        console.print("No figures as files: pip install 'labyrinth-datasets[analysis]' for them.")
    html = page(datasets, results, None if figures is None else FIGURES_FOLDER)
    with held(data_dir, FOLDER):
        _write(data_dir / FOLDER, html, figures)
    return data_dir / FOLDER / PAGE


def _write(folder: Path, html: str, figures: Mapping[str, bytes] | None) -> None:
    """Write the page, and put the figures in place of earlier ones, unless they were not drawn."""
    own = _own_files(folder)
    files = {**(figures or {}), PAGE: html.encode()}
    others = own.others(files)
    if PAGE in others:
        raise DatasetError(
            f"{folder / PAGE} was made or changed by somebody else: move it away, or choose "
            "another data_dir"
        )
    # A list may name anything, and nothing but figures is ever removed.
    left = {name for name, _ in own.hashes if is_figure(name)}
    gone = set() if figures is None else left - set(files)
    (folder / FIGURES_FOLDER if figures else folder).mkdir(parents=True, exist_ok=True)
    now = own.replace({name: files[name] for name in files if name not in others}, gone)
    write_list(folder, now.hashes)
    if others:
        say(f"Not written, since somebody else made or changed them: {', '.join(others)}.")


def _own_files(folder: Path) -> OwnFiles:
    """Return the files of the report that is there."""
    own, page = OwnFiles.read(folder, always=re.escape(PAGE)), folder / PAGE
    if own.hashes or not page.is_file() or _TITLE not in page.read_bytes():
        return own
    inside = (f"{FIGURES_FOLDER}/{path.name}" for path in folder.glob(f"{FIGURES_FOLDER}/*"))
    return OwnFiles.adopted(folder, [PAGE, *filter(is_figure, inside)])


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
    return files("pipeline.report").joinpath(f"page/{name}").read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """Return the hash of a text in the form of a content security policy."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
