"""Tables as CSV, in which a spreadsheet computes nothing."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence

_FORMULA = re.compile(r"(?=[=+\-@\t\r])")
"""How a text begins that a spreadsheet would compute."""


def as_csv(columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> str:
    """Return a table as CSV; texts that a spreadsheet would compute get an apostrophe before them.

    Args:
        columns: The names of the columns, in order.
        rows: The values of each row by column; others in it are left out.
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
