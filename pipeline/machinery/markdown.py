"""Markdown tables, and numbers with their nouns."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence


def table(heading: Sequence[str], rows: Iterable[Sequence[str]], alignment: str = "") -> str:
    """Return a Markdown table; `alignment` has l or r for each column, by default l, then r."""
    sides = alignment or "l" + "r" * (len(heading) - 1)
    rule = ["---:" if side == "r" else "---" for side in sides]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (heading, rule, *rows))


def plain(text: str) -> str:
    """Return a text on one line, escaped so that Markdown shows it literally."""
    return re.sub(r"([\\`*\[\]<>|!#&~$])", r"\\\1", " ".join(text.split()))


def count(number: int, thing: str) -> str:
    """Return a number of things, such as `1 row` or `1,000 rows`."""
    return f"{number:,} {thing}{'' if number == 1 else 's'}"
