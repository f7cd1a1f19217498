"""Update the tables in the pages of docs/studies, and draw their figures, from docs/results.

    python scripts/studies/report_pages.py
    python scripts/studies/report_pages.py --figures docs/pictures

In a page, a table is between `<!-- table: NAME -->` and `<!-- end of table -->`. Figures are PNG.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import matplotlib as mpl
import report_authors
import report_benchmarks
import report_claims
import report_coverage
import report_environments
import report_memorising
import report_paper
import report_scaling
import report_shifts
from figures import STYLE, save
from matplotlib.figure import Figure

ROOT = Path(__file__).parents[2]

TABLES: Mapping[str, Callable[[], str]] = {
    "thousand": report_claims.rates,
    "known routes": report_claims.known_routes,
    "known routes by method": report_claims.by_route,
    "pairs": report_claims.pairs,
    "coverage": report_coverage.coverage,
    "shifts": report_shifts.rates,
    "effects": report_shifts.effects,
    "new routes": report_claims.new_routes,
    "matching": report_claims.matching,
    "goals": report_shifts.goals,
    "memory": report_paper.memory,
    "3x3": partial(report_paper.of_size, config="3x3"),
    "4x4": partial(report_paper.of_size, config="4x4"),
    "5x5": partial(report_paper.of_size, config="5x5"),
    "authors": report_authors.beside,
    "resnet": report_authors.resnet,
    "verdicts": report_authors.verdicts,
    "counted verdicts": report_authors.counted_verdicts,
    "costs": report_claims.costs,
    "missing": report_claims.missing,
    "memorising headline": report_memorising.headline,
    "memorising": report_memorising.methods,
    "memorising validity": report_memorising.validity,
    "memorising uniform": report_memorising.uniform,
    "memorising conditions": report_memorising.conditions,
    "memorising missing": report_memorising.missing,
    "environments": report_environments.like_theirs,
    "two episodes": report_environments.two_episodes,
    "environments over many episodes": report_environments.many,
    "benchmarks": report_benchmarks.certified,
    "published": report_benchmarks.published,
    "procgen": report_benchmarks.procgen,
    "procgen views": report_benchmarks.procgen_views,
    "scaling": report_scaling.rates,
    "scaling new ends": report_scaling.new_ends,
    "laws": report_scaling.laws,
    "limits": report_scaling.limits,
    "scaling missing": report_scaling.missing,
}
"""Name of a table -> the function that makes it."""

ARCHIVED = frozenset(
    (
        *("planner by seed", "exchanged", "powers", "looks", "peers"),
        *("ingredients", "without grid", "numbers of labyrinths", "tasks"),
        *("mapper", "on slots", "mapper sizes", "reinforcement"),
    )
)
"""Tables of finished studies, which stay; docs/results/ARCHIVE.md says how they were made."""

FIGURES: Mapping[str, Callable[[], Figure]] = {
    "claims": report_claims.draw,
    "shifts": report_shifts.draw,
    "benchmarks": report_benchmarks.draw,
    "scaling": report_scaling.draw,
}
"""Name of a figure's file -> the function that draws it."""

PLACE = re.compile(r"(<!-- table: ([\w ]+) -->\n).*?(<!-- end of table -->)", re.DOTALL)


def main() -> None:
    """Write the tables and draw the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figures", type=Path, help="folder for the figures")
    given = parser.parse_args()
    for page in sorted((ROOT / "docs/studies").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        page.write_text(with_tables(text), encoding="utf-8")
    if given.figures is not None:
        given.figures.mkdir(parents=True, exist_ok=True)
        with mpl.rc_context(STYLE):
            for name, draw in FIGURES.items():
                save(draw(), given.figures / f"{name}.png")


def with_tables(page: str) -> str:
    """Return the text of a page with its tables regenerated from the results.

    Raises:
        KeyError: A page names a table that no function makes.
    """

    def made(place: re.Match[str]) -> str:
        begin, name, end = place.groups()
        if name in ARCHIVED:
            return place[0]
        return f"{begin}\n{TABLES[name]()}\n\n{end}"

    return PLACE.sub(made, page)


if __name__ == "__main__":
    main()
