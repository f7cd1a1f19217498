"""The pages on studies have the tables that follow from docs/results, and no other figures.

In one of them each cell of the paper has a verdict.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import report_authors
import report_pages as pages

from pipeline.results.paper import paper_figures

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "studies").glob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_tables_of_a_page_follow_from_the_results(page):
    text = page.read_text(encoding="utf-8")
    assert pages.with_tables(text) == text


def test_every_table_of_figures_is_made_by_the_script_and_every_one_it_makes_is_shown():
    named = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        named += [name for _, name, _ in pages.PLACE.findall(text)]
        by_hand = pages.PLACE.sub("", text)
        assert re.findall(r"^\|.*-:.*\|$", by_hand, re.MULTILINE) == [], page.name
    assert sorted(named) == sorted(pages.TABLES)


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
