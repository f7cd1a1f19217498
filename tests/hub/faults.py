"""Faults of the Hub on demand, changeable while it runs."""

from __future__ import annotations

import re
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partialmethod
from typing import Any

UNLIMITED = 1 << 30
PAGE_SIZE = 1000
"""Entries on a page of the Hub."""


@dataclass
class Rule:
    """What to do with the calls that match, after `skip` of them, `times` times."""

    effect: str
    method: str
    path: str
    times: int = 1
    skip: int = 0
    status: int = 503
    after: bool = False
    body: bytes = b""
    """What `answer` sends."""
    headers: Mapping[str, str] = field(default_factory=dict)
    """Further headers of `fail` and `answer`."""
    reached: threading.Event = field(default_factory=threading.Event, repr=False)
    """Set when it has struck for the first time."""
    released: threading.Event = field(default_factory=threading.Event, repr=False)

    def takes(self, method: str, path: str) -> bool:
        """Return whether the rule is for this call, which it counts."""
        matches = re.fullmatch(self.method, method) and re.search(self.path, path)
        if self.times <= 0 or not matches:
            return False
        if self.skip > 0:
            self.skip -= 1
            return False
        self.times -= 1
        return True


class Faults:
    """The faults of a running Hub.

    `fail` answers with a status, and does nothing. `drop` closes the connection, and does nothing.
    `hold` keeps calls waiting until `release`: before anything is done, or `after`, unanswered.
    `rule.reached` is set once one is there; then is the time to kill the client. A call whose
    client has gone by the time of its release has no effect.
    `stall` sends half of the answer, and the rest after `release`.
    `lose_response` does what is asked, then closes the connection.
    `answer` answers with a status and a body, and does nothing; or `after` what is asked is done.
    `damage` changes a byte of the answer, and `cut` sends half of it and closes the connection.
    `stale` answers as before the newest commit.
    `intrude` lets another user commit first, or `after` what is asked is done.

    `method` is a pattern such as `GET|HEAD`, `path` one that is searched in the unquoted path.
    `times` is how many matching calls are hit; `skip` lets that many pass before.
    """

    COMMANDS = ("fail", "drop", "lose_response", "occupy_tag", "set_page_size", "clear")
    """What a request to the Hub may call, too."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.rules: list[Rule] = []
        self.clear()

    def clear(self) -> None:
        """Let everything work again; calls that are held go on."""
        self.release()
        self.rules = []
        self.page_size = PAGE_SIZE
        self.tags_to_occupy = 0

    def _add(self, effect: str, method: str, path: str, **options: Any) -> Rule:
        rule = Rule(effect, method, path, **options)
        with self._lock:
            self.rules.append(rule)
        return rule

    fail = partialmethod(_add, "fail")
    drop = partialmethod(_add, "drop")
    hold = partialmethod(_add, "hold")
    stall = partialmethod(_add, "stall")
    lose_response = partialmethod(_add, "lose response")
    answer = partialmethod(_add, "answer")
    damage = partialmethod(_add, "damage")
    cut = partialmethod(_add, "cut")
    stale = partialmethod(_add, "stale")
    intrude = partialmethod(_add, "intrude")

    def occupy_tag(self) -> None:
        """Let another user set the next tag asked for, at the repository's first commit."""
        self.tags_to_occupy += 1

    def set_page_size(self, entries: int = PAGE_SIZE) -> None:
        """List that many entries on a page."""
        self.page_size = entries

    def release(self) -> None:
        """Let the calls go on that are held, and hold no more."""
        with self._lock:
            for rule in self.rules:
                if rule.effect in ("hold", "stall"):
                    rule.times = 0
                    rule.released.set()

    def control(self, commands: dict[str, dict[str, Any]]) -> None:
        """Call methods by name: {"fail": {"method": "POST", "path": "/commit/"}}.

        Raises:
            ValueError: There is no such command, or not with such arguments.
        """
        for name, arguments in commands.items():
            if name not in self.COMMANDS:
                raise ValueError(f"command is {name!r}; allowed are {', '.join(self.COMMANDS)}")
            try:
                getattr(self, name)(**arguments)
            except TypeError as error:
                raise ValueError(f"arguments of {name}: {error}") from error

    def take(self, method: str, path: str) -> list[Rule]:
        """Return the rules that are for this call, counting it."""
        with self._lock:
            return [rule for rule in self.rules if rule.takes(method, path)]
