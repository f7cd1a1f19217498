"""The stage `analyse`: a certificate of leakage, and the shift between splits.

They are left in `analysis.json` in the folder of the dataset, beside its counts, where the card
finds them; the certificate of a dataset from elsewhere in `analysis/` in `data_dir`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Column, Table

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import ANALYSIS, Manifest
from labyrinth_core.data.splits import BASE_SPLITS, SHIFTS, SPLITS
from labyrinth_core.data.storage import AnyPath, write_text
from labyrinth_core.world.labyrinth import Labyrinth
from pipeline.config.run import Run
from pipeline.inspection.counting import Content, count_dataset
from pipeline.inspection.counts import DatasetCounts
from pipeline.inspection.elsewhere import read_elsewhere
from pipeline.inspection.leakage import NEAR, Certificate, certify
from pipeline.inspection.measures import Shift, compare
from pipeline.inspection.shift import PERMUTATIONS
from pipeline.machinery.console import console, progress, say

FORMAT = 1
LEAKS_SHOWN = 10
"""The largest number of labyrinths with the same fault that are named in the terminal."""
SIGNIFICANT = 0.05


def run(run: Run) -> None:
    """Analyse the dataset of a run, or the one from elsewhere that it names.

    Raises:
        DatasetError: There is no dataset, or it is damaged.
        OSError: The result cannot be written.
    """
    source = run.options.leakage.source
    for line in _analyse(run) if source is None else _certify(source, run):
        say(line)


def _certify(source: str, run: Run) -> Iterator[str]:
    """Certify a dataset from elsewhere, print the table, and yield the other lines to print.

    Raises:
        DatasetError: Some labyrinths could not be read; the others are certified before.
    """
    config = run.options.leakage.config
    found = read_elsewhere(source, config)
    certificate = certify(found.splits)
    repeated = {split: certificate.repeated[split] + n for split, n in found.copies.items()}
    certificate = replace(certificate, repeated=repeated)
    path = _certificate_path(run, source, config)
    told = {
        "source": source,
        "config": config,
        "structures_alone": found.structures_alone,
        "problems": found.problems,
        "leakage": certificate.to_json(),
        "files": found.files,
    }
    _write(path, told)
    console.print(_leakage_table(certificate, with_routes=not found.structures_alone))
    yield from _leaks(certificate, found.files)
    if found.structures_alone:
        yield "No start and goal is known of some labyrinths: structures alone are compared."
    yield f"{path} has all of it."
    if found.problems:
        yield from found.problems[1:LEAKS_SHOWN]
        raise DatasetError(
            f"{len(found.problems):,} labyrinths or files could not be read, and are not in the "
            f"certificate; {path} lists them all; the first: {found.problems[0]}"
        )


def _certificate_path(run: Run, source: str, config: str | None) -> AnyPath:
    """Return where the certificate of a dataset from elsewhere is written, in a folder that is."""
    # A folder for the configs of a source, as a name of both could be that of another source.
    parts = [source] if config is None else [source, config]
    names = [re.sub(r"[^\w.-]+", "-", part).strip("-.") or "dataset" for part in parts]
    path = run.data_dir / f"analysis/{'/'.join(names)}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _analyse(run: Run) -> Iterator[str]:
    """Analyse a dataset, leave the result in its folder, and yield the lines to print."""
    folder = run.folder
    manifest = Manifest.read(folder)
    counts, contents = read_contents(folder, manifest, run.options.workers)
    counts.write(folder, manifest)
    labyrinths = {split: content.labyrinths for split, content in contents.items()}
    certificate = certify(labyrinths, counts.certificate)
    pairs = [("train", split) for split in BASE_SPLITS[1:]] + [("validation", "test")]
    shifts = compare(contents, pairs, manifest.config.seed)
    for shift in manifest.config.shifts:  # Each is a question of its own, and a family of tests.
        pairs = [(SPLITS[shift].parent or "test", shift)]
        shifts += compare(contents, pairs, manifest.config.seed)
    content = {
        "name": manifest.config.name,
        "fingerprint": manifest.fingerprint,
        "leakage": certificate.to_json(),
        "shift": {
            "permutations": PERMUTATIONS,
            "measures": [shift.to_json() for shift in shifts],
        },
    }
    _write(folder / ANALYSIS, content)
    yield from _leaks(certificate, {})
    yield from _near(certificate)
    if manifest.config.goals == "varied":
        yield _varied(labyrinths)
    yield from _shifted(shifts)
    yield f"{folder / ANALYSIS} has all of it; stages=[report] shows it as tables."


def read_contents(
    folder: AnyPath, manifest: Manifest, workers: int = 1
) -> tuple[DatasetCounts, dict[str, Content]]:
    """Return the counts of a dataset and the content of each split.

    Raises:
        DatasetError: A shard is missing, damaged, or not the manifest's.
    """
    parts: dict[str, list[Content]] = {}
    with progress() as bars:
        bar = bars.add_task("analyse", total=sum(shard.rows for shard in manifest.shards))
        counts = count_dataset(
            folder,
            manifest,
            workers,
            advance=lambda rows: bars.advance(bar, rows),
            keep=lambda split, content: parts.setdefault(split, []).append(content),
        )
    return counts, {split: Content.joined(of_split) for split, of_split in parts.items()}


def _write(path: AnyPath, content: Mapping[str, Any]) -> None:
    write_text(path, json.dumps({"format": FORMAT} | dict(content), indent=1) + "\n")


def _leakage_table(certificate: Certificate, *, with_routes: bool) -> Table:
    walls = [f"{walls} wall{'s' * (walls > 1)}" for walls in NEAR]
    headings = ("of", "equal", "mirrored", "turned", *walls, "same\nroute", "nearest")
    table = Table(
        "splits",
        *(Column(heading, justify="right") for heading in headings),
        title="leakage: labyrinths of the second split with a counterpart in the first",
        caption="nearest: walls to the nearest structure of the first, least and median",
        box=SIMPLE_HEAD,
        padding=0,
    )
    for pair in certificate.pairs:
        of = certificate.labyrinths[pair.second]
        counts = [of, len(pair.equal), len(pair.mirrored), len(pair.symmetric)]
        counts += [pair.within(walls) for walls in NEAR]
        table.add_row(
            f"{pair.first}\n{pair.second}",
            *(f"{count:,}" for count in counts),
            f"{len(pair.same_route):,}" if with_routes else "-",
            pair.spread(of),
        )
    return table


def _leaks(certificate: Certificate, files: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """Yield a line for each leak, for the first `LEAKS_SHOWN` of a kind."""
    found = list(_shared(certificate, files))
    for split, count in certificate.repeated.items():
        if count and not certificate.may_repeat(split):
            found.append(f"{split} repeats {count:,} structures")
    for split, ids in certificate.strangers.items():
        if ids:
            parent = SPLITS[split].parent
            found.append(f"{split} has {len(ids):,} structures that {parent} has not, as {ids[0]}")
    if found:
        yield "Leakage:"
        yield from found
    else:
        yield "Leakage: no structure is in two splits, not even mirrored; none is repeated."
    if certificate.cut:
        yield f"{certificate.cut:,} labyrinths have more optimal routes than were compared"


def _shared(certificate: Certificate, files: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    for pair in certificate.pairs:
        mirrored = {key: pair.mirrored[key] for key in pair.mirrored if key not in pair.equal}
        for found, relation in ((pair.equal, "the structure"), (mirrored, "a mirror image")):
            for number in list(found)[:LEAKS_SHOWN]:
                other = _named(pair.first, found[number], files)
                yield f"{_named(pair.second, number, files)} has {relation} of {other}"
            if len(found) > LEAKS_SHOWN:
                yield f"and {len(found) - LEAKS_SHOWN:,} more of {pair.second}"


def _named(split: str, number: str, files: Mapping[str, Mapping[str, str]]) -> str:
    return files[split][number] if files else f"{split} {number}"


def _near(certificate: Certificate) -> Iterator[str]:
    """Yield a line for each pair of splits that says how near they are."""
    for pair in certificate.pairs:
        if pair.first != "train" and pair.second in SHIFTS:
            continue
        least, most = NEAR[0], NEAR[-1]
        yield (
            f"  {pair.first}, {pair.second}: {pair.within(least):,} of "
            f"{certificate.labyrinths[pair.second]:,} within {least} wall, "
            f"{pair.within(most):,} within {most}, {len(pair.same_route):,} share a best route"
        )


def _varied(labyrinths: Mapping[str, Sequence[Labyrinth]]) -> str:
    """Return the line that says how much start and goal vary."""
    train, test = (
        [(each.start, each.goal) for each in labyrinths[split]] for split in ("train", "test")
    )
    seen = set(train)
    known = sum(pair in seen for pair in test)
    return (
        f"Start and goal vary: {len(seen):,} pairs in train, {len(set(test)):,} in test; "
        f"{known:,} of {len(test):,} labyrinths of test have a pair of train."
    )


def _shifted(shifts: Sequence[Shift]) -> Iterator[str]:
    """Yield a line for each pair of splits with the measures that differ by more than chance."""
    yield f"Shift that is not chance, by Holm's p of {SIGNIFICANT} or less:"
    for splits, of_pair in groupby(shifts, lambda shift: (shift.first, shift.second)):
        measures = [shift.measure for shift in of_pair if shift.corrected <= SIGNIFICANT]
        yield f"  {', '.join(splits)}: {', '.join(measures) or 'none'}"
