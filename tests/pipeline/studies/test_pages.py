"""The pages on studies have the tables that follow from docs/results, and no other figures."""

from __future__ import annotations

import re
import sys
from importlib import import_module
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
PAGES = sorted((ROOT / "docs" / "studies").glob("*.md"))

sys.path.insert(0, str(ROOT / "scripts" / "studies"))
pages = import_module("report_pages")
sys.path.pop(0)


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
