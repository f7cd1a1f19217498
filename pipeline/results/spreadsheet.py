"""Write tables as CSV that is safe to open in a spreadsheet: no cell is read as a formula."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence

_FORMULA = re.compile(r"(?=[=+\-@\t\r])")
"""Matches the start of a text that a spreadsheet would read as a formula."""


def as_csv(columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> str:
    """Return a table as CSV; an apostrophe precedes texts that look like a formula.

    Args:
        columns: The names of the columns, in order.
        rows: The values of each row by column; values of other columns are left out.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {
            name: f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value
            for name, value in row.items()
        }
        for row in rows
    )
    return text.getvalue()
