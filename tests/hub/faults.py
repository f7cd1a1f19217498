"""What goes wrong on demand, changeable while the Hub runs."""

from __future__ import annotations

import re
import threading
from dataclasses import dataclass, field
from typing import Any

UNLIMITED = 1 << 30
PAGE_SIZE = 1000
"""Entries on a page of the Hub."""


@dataclass
class Rule:
    """What to do with the calls that match, after `skip` of them, `times` times."""

    effect: str
    """`fail`, `drop`, `delay`, `hold`, `hold after`, `lose response` or `break after`."""
    method: str
    path: str
    times: int = 1
    skip: int = 0
    status: int = 503
    message: str = ""
    retry_after: int | None = None
    seconds: float = 0.0
    reached: threading.Event = field(default_factory=threading.Event, repr=False)
    """Set when it has struck for the first time."""
    released: threading.Event = field(default_factory=threading.Event, repr=False)

    def takes(self, method: str, path: str) -> bool:
        """Return whether the rule is for this call, which it counts."""
        if self.times <= 0 or not re.fullmatch(self.method, method):
            return False
        if not re.search(self.path, path):
            return False
        if self.skip > 0:
            self.skip -= 1
            return False
        self.times -= 1
        return True


class Faults:
    """The faults of a running Hub. `path` is a pattern searched in the unquoted path.

    `times` is how many matching calls are hit; `skip` lets that many pass before. Methods may be
    patterns too: `GET|HEAD`.
    """

    COMMANDS = (
        "fail",
        "drop",
        "delay",
        "hold",
        "release",
        "lose_response",
        "break_after",
        "move_head",
        "occupy_tag",
        "slow_put",
        "set_page_size",
        "set_broken",
        "clear",
    )
    """What the control endpoint may call."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.rules: list[Rule] = []
        self.clear()

    def clear(self) -> None:
        """Let everything work again; calls that are held go on."""
        self.release()
        self.rules = []
        self.broken = False
        self.page_size: int | None = None
        self.put_chunk: int | None = None
        self.put_seconds = 0.0
        self._interferences = {"move head": 0, "occupy tag": 0}

    def fail(
        self,
        method: str,
        path: str,
        status: int = 503,
        times: int = 1,
        skip: int = 0,
        retry_after: int | None = None,
        message: str = "",
    ) -> Rule:
        """Answer with that status, and do nothing."""
        rule = Rule("fail", method, path, times, skip, status, message, retry_after)
        return self._add(rule)

    def drop(self, method: str, path: str, times: int = 1, skip: int = 0) -> Rule:
        """Close the connection, and do nothing."""
        return self._add(Rule("drop", method, path, times, skip))

    def delay(
        self, method: str, path: str, seconds: float, times: int = UNLIMITED, skip: int = 0
    ) -> Rule:
        """Wait before doing anything."""
        return self._add(Rule("delay", method, path, times, skip, seconds=seconds))

    def hold(
        self, method: str, path: str, times: int = 1, skip: int = 0, after: bool = False
    ) -> Rule:
        """Keep calls waiting until `release`: before anything is done, or `after`, unanswered.

        `rule.reached.wait(seconds)` waits until one is there; then is the time to kill the
        client. A call whose client has gone by the time of its release has no effect.
        """
        return self._add(Rule("hold after" if after else "hold", method, path, times, skip))

    def lose_response(
        self, method: str, path: str, status: int = 0, times: int = 1, skip: int = 0
    ) -> Rule:
        """Do what is asked, then close the connection or, with a status, answer that instead."""
        return self._add(Rule("lose response", method, path, times, skip, status))

    def break_after(self, method: str, path: str, skip: int = 0) -> Rule:
        """Answer this call as it should be, and 500 to all that follow."""
        return self._add(Rule("break after", method, path, 1, skip))

    def move_head(self, times: int = 1) -> None:
        """Let somebody else commit just before the next commits are looked at."""
        self._interferences["move head"] += times

    def occupy_tag(self, times: int = 1) -> None:
        """Let somebody else set the next tags asked for, at the repository's first commit."""
        self._interferences["occupy tag"] += times

    def slow_put(self, seconds: float, chunk: int = 4096) -> None:
        """Take so long for each chunk of an uploaded content, to be killed in."""
        self.put_seconds, self.put_chunk = seconds, chunk

    def set_page_size(self, entries: int | None) -> None:
        """List that many entries a page; None for as many as the Hub does."""
        self.page_size = entries

    def set_broken(self, broken: bool = True) -> None:
        """Answer every call with 500."""
        self.broken = broken

    def release(self) -> None:
        """Let the calls go on that are held, and hold no more."""
        with self._lock:
            for rule in self.rules:
                if rule.effect.startswith("hold"):
                    rule.times = 0
                    rule.released.set()

    def control(self, commands: dict[str, dict[str, Any]]) -> None:
        """Call methods by name: {"fail": {"method": "POST", "path": "/commit/"}}.

        Raises:
            ValueError: if there is no such command, or not with such arguments.
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

    def take_interference(self, name: str) -> bool:
        """Return whether somebody else does that now: `move head` or `occupy tag`."""
        with self._lock:
            waiting = self._interferences[name]
            self._interferences[name] = max(0, waiting - 1)
        return waiting > 0

    def _add(self, rule: Rule) -> Rule:
        with self._lock:
            self.rules.append(rule)
        return rule
