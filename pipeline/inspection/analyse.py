"""The stage `analyse`: leakage and shift between the splits of a dataset.

It writes `analysis.json` in the dataset's folder. For an external dataset (`leakage.source`), whose
labyrinths come from files by split or from the column `info`, it writes only the leakage, in
`data_dir/analysis/`.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Column, Table

from labyrinth_core.data.dataset import why_unavailable
from labyrinth_core.data.errors import MALFORMED, DatasetError, one_line, readable
from labyrinth_core.data.manifest import ANALYSIS, Manifest
from labyrinth_core.data.splits import BASE_SPLITS, SPLITS
from labyrinth_core.data.storage import AnyPath
from labyrinth_core.language.collection import KINDS, files_in, is_collection, read_collection
from labyrinth_core.language.source_text import printable_line
from labyrinth_core.language.text import parse
from labyrinth_core.world.labyrinth import Labyrinth, Structure
from pipeline.config.stage import Job
from pipeline.inspection import front_matter
from pipeline.inspection.counts import Content
from pipeline.inspection.leakage import (
    NEAR,
    Held,
    Keys,
    Leakage,
    certify,
    find_leakage,
    id_of,
    structure_of,
)
from pipeline.inspection.options import AnalyseOptions
from pipeline.inspection.shift import PERMUTATIONS, compare
from pipeline.inspection.statistics import DatasetStatistics, count_dataset
from pipeline.machinery.artifact import leave
from pipeline.machinery.console import console, say
from pipeline.machinery.folders import within

FORMAT = 1
"""The format of `analysis.json`."""
FOLDER = "analysis"
"""The folder in `data_dir` for the analyses of external datasets."""
LEAKS_SHOWN = 10
"""The maximum number of leaks or problems of one kind printed in the terminal."""


def run(job: Job[AnalyseOptions]) -> None:
    """Analyse the dataset of a job, or the external dataset in `leakage.source`.

    Raises:
        DatasetError: The dataset is missing or damaged.
        OSError: The result cannot be written.
    """
    source = job.options.leakage.source
    for line in _analyse(job) if source is None else _analyse_elsewhere(source, job):
        say(line)


def _analyse(job: Job[AnalyseOptions]) -> Iterator[str]:
    """Analyse a dataset, leave the result in its folder, and yield the lines to print."""
    folder = job.folder
    manifest = Manifest.read(folder)
    statistics, contents = read_contents(folder, manifest, job.options.workers)
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
    leave(folder, {ANALYSIS: text}, overwrite=job.options.overwrite)
    yield from _leaks(leakage, {})
    yield f"Wrote {folder / ANALYSIS} (near-duplicates, tests of shift)."


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


def _analyse_elsewhere(source: str, job: Job[AnalyseOptions]) -> Iterator[str]:
    """Analyse an external dataset, print the table, and yield the other lines to print.

    Raises:
        DatasetError: Some labyrinths could not be read; raised after analysing the others.
    """
    config = job.options.leakage.config
    found = read_elsewhere(source, config)
    keys = {split: Keys.of(labyrinths) for split, labyrinths in found.splits.items()}
    leakage = find_leakage(found.splits, certify(keys))
    content = {
        "source": source,
        "config": config or found.config,
        "structures_alone": found.structures_alone,
        "problems": found.problems,
        "leakage": leakage.to_json(),
        "files": found.files,
    }
    name = _name_of(source, config)
    place = within(job.data_dir, FOLDER)
    leave(place, {name: _as_text(content).encode()}, overwrite=job.options.overwrite)
    path = job.data_dir / FOLDER / name
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
        legible = re.sub(r"[^\w.-]+", "-", part).strip("-.")[:99]
        names.append(f"{legible}-{hashlib.sha256(part.encode()).hexdigest()[:8]}")
    return f"{'/'.join(names)}.json"


def _as_text(content: Mapping[str, Any]) -> str:
    return json.dumps({"format": FORMAT} | dict(content), indent=1) + "\n"


def _table(leakage: Leakage, *, with_routes: bool) -> Table:
    walls = [f"{walls}\nwall{'s' * (walls > 1)}" for walls in NEAR]
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
            f"{pair.first}, {pair.second}",
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
        yield "Leakage: no structure is in two splits, and none is repeated."
        yield f"Mirrored with start and goal kept: none.{_turned(leakage)}"
    if leakage.cut:
        yield f"{leakage.cut:,} labyrinths have too many optimal routes to compare all of them"


def _turned(leakage: Leakage) -> str:
    """Say how many structures of each split are rotated or reflected ones of another split."""
    found: dict[str, list[str]] = {}
    for each in leakage.pairs:
        if each.symmetric:
            counts = found.setdefault(each.pair.first, [])
            counts.append(f"{len(each.symmetric):,} of {each.pair.second}")
    told = "; ".join(f"{' and '.join(counts)} in {first}" for first, counts in found.items())
    return f"\nTurned: {told}." if found else " Turned: none."


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


# External datasets.


@dataclass(frozen=True)
class Elsewhere:
    """The labyrinths of an external dataset, with the problems in reading it."""

    splits: Mapping[str, Sequence[Held]]
    """Split -> its labyrinths, in order; or all structures, if any has no start and goal."""
    files: Mapping[str, Mapping[str, str]]
    """Split -> id of a labyrinth -> its first place in a file; empty if not read from files."""
    problems: Sequence[str]
    """A line for each labyrinth, or file, that could not be read."""
    config: str | None = None
    """The config that was read, if the dataset has named configs."""

    @property
    def structures_alone(self) -> bool:
        """Whether the splits hold structures instead of labyrinths."""
        return any(isinstance(held[0], Structure) for held in self.splits.values() if held)


def read_elsewhere(source: str, config: str | None) -> Elsewhere:
    """Return the labyrinths of an external dataset.

    Args:
        source: A file or a folder for `read_collection`; or, for `load_dataset`, a folder with
            Parquet files or an id on the Hub, of which only the column `info` is read.
        config: The config of the dataset, if it has several.

    Raises:
        DatasetError: The source is none of these, or no labyrinth in it can be read.
        OSError: A file cannot be read.
    """
    path = Path(source).expanduser()
    if path.is_file() and not is_collection(path):
        raise DatasetError(f"{source}: the name of a file must end in {', '.join(KINDS)}")
    files = files_in(path) if path.is_dir() else []
    rows = any(file.suffix == ".parquet" for file, _ in files)
    if path.is_file() or (path.is_dir() and not rows):
        found = _in_files(path)
        if found.splits:
            return found
        if found.problems or path.is_file():
            raise DatasetError(next(iter(found.problems), f"{source} holds no labyrinth"))
    if rows:  # `datasets` reads it without limits.
        with suppress(FileNotFoundError):
            front_matter.read_any(path / "README.md")
    # Resolved, because `datasets` finds no name for the folder `.`.
    streams, config = _infos_of(str(path.resolve()) if path.is_dir() else source, config)
    # Different texts may describe the same labyrinth, which then counts once.
    splits = {split: [*dict.fromkeys(_parsed(infos, split))] for split, infos in streams.items()}
    problems = [f"{printable_line(str(file))}: {reason}" for file, reason in files if reason]
    return Elsewhere(splits, {}, problems, config)


def _in_files(path: Path) -> Elsewhere:
    """Return the labyrinths in a file or a folder."""
    entries = list(read_collection(path))
    alone = any(isinstance(entry.found, Structure) for entry in entries)
    splits: dict[str, list[Held]] = {}
    files: dict[str, dict[str, str]] = {}
    for split, place, found, _ in entries:
        if found is not None:
            held = structure_of(found) if alone else found
            splits.setdefault(split, []).append(held)
            files.setdefault(split, {}).setdefault(id_of(held), place)
    return Elsewhere(splits, files, [entry.problem for entry in entries if entry.problem])


def _parsed(infos: Iterator[str], split: str) -> Iterator[Labyrinth]:
    for info in dict.fromkeys(infos):
        try:
            yield parse(info)
        except ValueError as error:
            # Its first line says what is wrong, the others show where.
            reason = str(error).partition("\n")[0]
            raise DatasetError(f"{split} info: not a labyrinth: {reason}") from error


def _infos_of(source: str, config: str | None) -> tuple[dict[str, Iterator[str]], str | None]:
    """Return the config of a dataset and, streamed, the values of `info` in each split.

    No other column is downloaded. The name of a default config is printed.

    Raises:
        DatasetError: There is no such dataset; or, while streaming, it cannot be read.
    """
    import yaml
    from datasets import load_dataset

    from labyrinth_core.data.hub import UNAVAILABLE, limit_silence

    limit_silence()
    try:
        splits = load_dataset(source, config, streaming=True, columns=["info"])
    except (*UNAVAILABLE, *MALFORMED, yaml.YAMLError) as error:  # `datasets` checks little.
        reason = why_unavailable(source, error)
        if isinstance(error, yaml.YAMLError):
            reason = f"{source}: the front matter of its README.md cannot be read"
        elif "BuilderConfig" in str(error):  # No such config; the message lists the others.
            reason = source
        raise DatasetError(f"{reason}: {one_line(error)}") from error
    if config is None and (default := next(iter(splits.values())).config_name) != "default":
        named = printable_line(f"{source}: default config {default}")  # Named in its README.md.
        say(f"{named}; leakage.config selects another.")
        config = default
    return {str(split): _infos(source, stream) for split, stream in splits.items()}, config


def _infos(source: str, stream: Any) -> Iterator[str]:
    with readable(source):
        tables = stream.with_format("arrow").iter(batch_size=256)
        for table in tables:
            if "info" not in table.column_names:
                raise DatasetError(f"{source} has no column info")
            for info in table["info"].to_pylist():
                if not isinstance(info, str):
                    raise DatasetError(f"{source}: info={info!r}: every row needs a text")
                yield info
