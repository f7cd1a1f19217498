"""An analysis as text: its JSON, its table, and the lines that name leaks."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Column, Table

from pipeline.inspection.leakage import NEAR, Leakage

FORMAT = 1
"""The format of an analysis."""
LEAKS_SHOWN = 10
"""The maximum number of leaks or problems of one kind printed in the terminal."""


def as_text(content: Mapping[str, Any]) -> str:
    """Return the JSON of an analysis."""
    return json.dumps({"format": FORMAT} | dict(content), indent=1) + "\n"


def table_of(leakage: Leakage, *, with_routes: bool) -> Table:
    """Return a table of the counts of each pair of splits, for the terminal."""
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


def leaks(leakage: Leakage, files: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """Yield a line for each leak, at most `LEAKS_SHOWN` of a kind."""
    problems = [*_shared(leakage, files), *leakage.certificate.problems_of_splits()]
    if problems:
        yield "Leakage:"
        yield from problems
    else:
        yield "Leakage: no structure is in two splits, and none is repeated."
        yield f"Mirrored with start and goal kept: none.{_turned(leakage)}"
    if leakage.cut:
        yield f"{leakage.cut:,} labyrinths have too many optimal routes to compare all of them"


def _turned(leakage: Leakage) -> str:
    """Say how many structures of each split are rotated or reflected ones of another split."""
    by_first: dict[str, list[str]] = {}
    for each in leakage.pairs:
        if each.symmetric:
            counts = by_first.setdefault(each.pair.first, [])
            counts.append(f"{len(each.symmetric):,} of {each.pair.second}")
    told = "; ".join(f"{' and '.join(counts)} in {first}" for first, counts in by_first.items())
    return f"\nTurned: {told}." if by_first else " Turned: none."


def _shared(leakage: Leakage, files: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    def named(split: str, number: str) -> str:
        return files[split][number] if files else f"{split} {number}"

    for pair in leakage.certificate.pairs:
        mirrored = {key: pair.mirrored[key] for key in pair.mirrored if key not in pair.equal}
        for shared, relation in ((pair.equal, "the structure"), (mirrored, "a mirror image")):
            for number, other in list(shared.items())[:LEAKS_SHOWN]:
                yield (f"{named(pair.second, number)} has {relation} of {named(pair.first, other)}")
            if len(shared) > LEAKS_SHOWN:
                yield f"and {len(shared) - LEAKS_SHOWN:,} more of {pair.second}"
