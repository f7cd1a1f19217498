"""The stage `analyse`: leakage and shift between the splits of a dataset.

It writes `analysis.json` in the dataset's folder. For an external dataset (`leakage.source`) it
writes only the leakage, in `data_dir/analysis/`.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Column, Table

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import ANALYSIS, Manifest
from labyrinth_core.data.splits import BASE_SPLITS, SPLITS
from labyrinth_core.data.storage import AnyPath
from pipeline.config.run import Run
from pipeline.inspection.counts import Content
from pipeline.inspection.elsewhere import read_elsewhere
from pipeline.inspection.leakage import NEAR, Leakage, find_leakage
from pipeline.inspection.measures import compare
from pipeline.inspection.shift import PERMUTATIONS
from pipeline.inspection.statistics import DatasetStatistics, count_dataset
from pipeline.machinery.artifact import leave
from pipeline.machinery.console import console, say

FORMAT = 1
"""The format of `analysis.json`."""
FOLDER = "analysis"
"""The folder in `data_dir` for the analyses of external datasets."""
LEAKS_SHOWN = 10
"""The maximum number of leaks or problems of one kind printed in the terminal."""


def run(run: Run) -> None:
    """Analyse the dataset of a run, or the external dataset in `leakage.source`.

    Raises:
        DatasetError: The dataset is missing or damaged.
        OSError: The result cannot be written.
    """
    source = run.options.leakage.source
    for line in _analyse(run) if source is None else _analyse_elsewhere(source, run):
        say(line)


def _analyse(run: Run) -> Iterator[str]:
    """Analyse a dataset, leave the result in its folder, and yield the lines to print."""
    folder = run.folder
    manifest = Manifest.read(folder)
    statistics, contents = read_contents(folder, manifest, run.options.workers)
    labyrinths = {split: content.labyrinths for split, content in contents.items()}
    leakage = find_leakage(labyrinths, statistics.certificate)
    pairs = [("train", split) for split in BASE_SPLITS[1:]] + [("validation", "test")]
    shifts = compare(contents, pairs, manifest.config.seed)
    for shift in manifest.config.shifts:  # Each has its own question, and its own family of tests.
        pairs = [(SPLITS[shift].parent or "test", shift)]
        shifts += compare(contents, pairs, manifest.config.seed)
    content = {
        "name": manifest.config.name,
        "fingerprint": manifest.fingerprint,
        "leakage": leakage.to_json(),
        "shift": {
            "permutations": PERMUTATIONS,
            "measures": [shift.to_json() for shift in shifts],
        },
    }
    text = _as_text(content).encode()
    leave(folder, {ANALYSIS: text}, overwrite=run.options.overwrite)
    yield from _leaks(leakage, {})
    yield f"{folder / ANALYSIS} has near-twins and tests of shift."


def read_contents(
    folder: AnyPath, manifest: Manifest, workers: int = 1
) -> tuple[DatasetStatistics, dict[str, Content]]:
    """Return the counts of a dataset and the content of each split, under a progress bar.

    Raises:
        DatasetError: A shard is missing or damaged, or differs from the manifest.
    """
    parts: dict[str, list[Content]] = {}
    statistics = count_dataset(
        folder,
        manifest,
        workers,
        "analyse",
        keep=lambda split, content: parts.setdefault(split, []).append(content),
    )
    return statistics, {split: Content.joined(of_split) for split, of_split in parts.items()}


def _analyse_elsewhere(source: str, run: Run) -> Iterator[str]:
    """Analyse an external dataset, print the table, and yield the other lines to print.

    Raises:
        DatasetError: Some labyrinths could not be read; raised after analysing the others.
    """
    config = run.options.leakage.config
    found = read_elsewhere(source, config)
    leakage = find_leakage(found.splits)
    repeated = leakage.certificate.repeated
    repeated = {split: repeated[split] + copies for split, copies in found.copies.items()}
    leakage = replace(leakage, certificate=replace(leakage.certificate, repeated=repeated))
    content = {
        "source": source,
        "config": config or found.config,
        "structures_alone": found.structures_alone,
        "problems": found.problems,
        "leakage": leakage.to_json(),
        "files": found.files,
    }
    name = _name_of(source, config)
    leave(run.data_dir / FOLDER, {name: _as_text(content).encode()})
    path = run.data_dir / FOLDER / name
    console.print(_table(leakage, with_routes=not found.structures_alone))
    yield from _leaks(leakage, found.files)
    if found.structures_alone:
        yield "Some labyrinths have no start and goal, so only structures are compared."
    yield f"{path} has the full results."
    if found.problems:
        yield from found.problems[1:LEAKS_SHOWN]
        raise DatasetError(
            f"{len(found.problems):,} labyrinths or files could not be read, and are not in the "
            f"analysis; {path} lists them all; the first: {found.problems[0]}"
        )


def _name_of(source: str, config: str | None) -> str:
    """Return the path in `FOLDER` of an external dataset's analysis, unique to source and config.

    A source with a named config gets a folder, with a file for the config.
    """
    names = []
    for part in (source,) if config is None else (source, config):
        readable = re.sub(r"[^\w.-]+", "-", part).strip("-.")[:99]
        names.append(f"{readable}-{hashlib.sha256(part.encode()).hexdigest()[:8]}")
    return f"{'/'.join(names)}.json"


def _as_text(content: Mapping[str, Any]) -> str:
    return json.dumps({"format": FORMAT} | dict(content), indent=1) + "\n"


def _table(leakage: Leakage, *, with_routes: bool) -> Table:
    walls = [f"{walls} wall{'s' * (walls > 1)}" for walls in NEAR]
    headings = ("of", "equal", "mirrored", "turned", *walls, "same\nroute", "nearest")
    table = Table(
        "splits",
        *(Column(heading, justify="right") for heading in headings),
        title="leakage: labyrinths of the second split with a counterpart in the first",
        caption="nearest: walls to the nearest structure of the first, minimum and median",
        box=SIMPLE_HEAD,
        padding=0,
    )
    for each in leakage.pairs:
        pair, of = each.pair, leakage.certificate.labyrinths[each.pair.second]
        counts = [of, len(pair.equal), len(pair.mirrored), len(each.symmetric)]
        counts += [each.within(walls) for walls in NEAR]
        table.add_row(
            f"{pair.first}\n{pair.second}",
            *(f"{count:,}" for count in counts),
            f"{len(each.same_route):,}" if with_routes else "-",
            each.spread(of),
        )
    return table


def _leaks(leakage: Leakage, files: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """Yield a line for each leak, at most `LEAKS_SHOWN` of a kind."""
    found = [*_shared(leakage, files), *leakage.certificate.problems_of_splits()]
    if found:
        yield "Leakage:"
        yield from found
    else:
        yield "Leakage: no structure is in two splits, not even mirrored; none is repeated."
    if leakage.cut:
        yield f"{leakage.cut:,} labyrinths have too many optimal routes to compare all of them"


def _shared(leakage: Leakage, files: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    def named(split: str, number: str) -> str:
        return files[split][number] if files else f"{split} {number}"

    for pair in leakage.certificate.pairs:
        mirrored = {key: pair.mirrored[key] for key in pair.mirrored if key not in pair.equal}
        for found, relation in ((pair.equal, "the structure"), (mirrored, "a mirror image")):
            for number, other in list(found.items())[:LEAKS_SHOWN]:
                yield (f"{named(pair.second, number)} has {relation} of {named(pair.first, other)}")
            if len(found) > LEAKS_SHOWN:
                yield f"and {len(found) - LEAKS_SHOWN:,} more of {pair.second}"
