"""The pages on studies have the tables that follow from docs/results, and no other figures.

In one of them each cell of the paper has a verdict.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import report_authors
import report_coverage
import report_pages as pages

from pipeline.results.tables import paper_figures

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[4]
PAGES = sorted((ROOT / "docs" / "studies").glob("*.md"))


SIMULATED = [case for case in report_coverage.CASES if case in ((1, 12, 0), (3, 32, 0.7))]
"""Two of the rows that are made by simulation, which takes a second a row and more."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_tables_of_a_page_follow_from_the_results(page, monkeypatch):
    text = page.read_text(encoding="utf-8")
    for seeds, labyrinths, spread in {*report_coverage.CASES} - {*SIMULATED}:
        text = text.replace(rf"| {seeds} | {labyrinths:,} | {spread or ''} |", "left out", 1)
    text = re.sub("^left out.*\n", "", text, flags=re.MULTILINE)
    monkeypatch.setattr(report_coverage, "CASES", SIMULATED)
    assert pages.with_tables(text) == text


def test_every_table_of_figures_is_made_by_the_script_or_archived_and_each_is_shown():
    named = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        named += [name for _, name, _ in pages.PLACE.findall(text)]
        by_hand = pages.PLACE.sub("", text)
        assert re.findall(r"^\|.*-:.*\|$", by_hand, re.MULTILINE) == [], page.name
    assert sorted(named) == sorted([*pages.TABLES, *pages.ARCHIVED])


@pytest.mark.parametrize(
    ("cell", "ours", "theirs", "verdict"),
    [
        (("5x5", "train", "bc"), 0.37, None, "impossible"),
        (("5x5", "test", "bc"), 0.04, None, "reproduced"),
        (("5x5", "test", "bc"), 0.48, 0.06, "explained"),
        (("5x5", "test", "bc"), 0.48, 0.30, "open"),
        (("5x5", "test", "bc"), 0.48, None, "not run"),
    ],
)
def test_a_cell_of_the_paper_has_the_first_verdict_that_holds(
    cell: tuple[str, str, str], ours: float, theirs: float | None, verdict: str
) -> None:
    figure = paper_figures()[cell]
    assert report_authors.judge(figure, ours, theirs) == (figure.sr, theirs, ours, verdict)


def test_the_intervals_cover_what_they_promise_by_the_table_of_the_page():
    # The first test of this file makes two rows of the table again, by simulation.
    text = (ROOT / "docs" / "studies" / "results.md").read_text(encoding="utf-8")
    (made,) = (each[0] for each in pages.PLACE.finditer(text) if each[2] == "coverage")
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in made.splitlines()
        if line.startswith("|")
    ][2:]
    promised = {"1": 93.0, "2": 85.0}
    usual = [row for row in rows if row[2] in ("", "0.7")]
    assert {(row[0], row[1]) for row in usual} >= {
        ("1", "12"),
        ("1", "32"),
        ("1", "100"),
        ("3", "100"),
    }
    for seeds, _, _, sr, spl, gap in usual:
        assert min(float(sr), float(spl)) >= promised.get(seeds, 90.0)
        assert float(gap) >= 85
