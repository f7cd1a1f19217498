"""What is said of a policy beside its results: its name, who made it, what it has learnt from."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

LONGEST = 300
"""The largest number of characters of a text."""

DETAILS = {
    "labyrinths": "labyrinths that it has learnt from",
    "steps": "steps that it has taken in environments while it learnt",
    "parameters": "parameters of its networks",
}
"""Detail -> what it is the number of."""

_DATE = re.compile(r"\d{4}-(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])", re.ASCII)
_URL = re.compile(r"https?://\S+")


@dataclass(frozen=True)
class Description:
    """What is said of a policy in tables; all but the name may be left out.

    Raises:
        ValueError: The name is empty, the address or the date is none, a text is too long or has
            characters that cannot be seen, or a detail is none of `DETAILS`, or no whole number.
    """

    name: str
    """What the policy is called."""
    author: str = ""
    """Who made it."""
    url: str = ""
    """Where it is described, as `https://...`."""
    date: str = ""
    """When it was evaluated, as `2026-11-30`."""
    budget: str = ""
    """What it has learnt from, in words."""
    details: Mapping[str, int] = field(default_factory=dict)
    """The same in numbers, by the names of `DETAILS`."""

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise ValueError(f"name={self.name!r}: say what the policy is called")
        for what in ("name", "author", "url", "date", "budget"):
            text = getattr(self, what)
            if len(text) > LONGEST or not text.isprintable():
                raise ValueError(
                    f"{what}={text!r:.60}: give one line of {LONGEST} characters at most, all of "
                    "which can be seen"
                )
        if self.url and not _URL.fullmatch(self.url):
            raise ValueError(f"url={self.url}: give an address such as https://example.org")
        if self.date and not _DATE.fullmatch(self.date):
            raise ValueError(f"date={self.date}: give a day such as 2026-11-30")
        for detail, number in self.details.items():
            if detail not in DETAILS:
                raise ValueError(f"details: {detail!r:.60}: choose from {', '.join(DETAILS)}")
            if type(number) is not int or not 0 <= number < 10**15:
                raise ValueError(f"details: {detail}={number!r:.60}: give a whole number from 0 on")
