"""What was asked of the Hub on loopback, and what it answered."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Exchange:
    """A request and its answer."""

    method: str
    path: str
    """Unquoted, without the query."""
    status: int
    """0 if the connection was dropped, by either side, before an answer."""
    token: str
    """Label of the token; `none` without one, `rejected` if unknown."""
    sent: int = 0
    """The bytes of the answer's body."""

    def __str__(self) -> str:
        return f"{self.status or '---'} {self.method:6} {self.path} ({self.token})"


class RequestLog:
    """All exchanges since the Hub was started."""

    def __init__(self) -> None:
        self.on_exchange: Callable[[Exchange], None] | None = None
        self._exchanges: list[Exchange] = []

    def __len__(self) -> int:
        """Return the number of exchanges, to be given as `since` later."""
        return len(self._exchanges)

    def add(self, exchange: Exchange) -> None:
        """Keep an exchange."""
        self._exchanges.append(exchange)
        if self.on_exchange is not None:
            self.on_exchange(exchange)

    def find(
        self,
        method: str | None = None,
        path: str = "",
        status: int | None = None,
        since: int = 0,
    ) -> list[Exchange]:
        """Return the exchanges with that method and status whose path matches a pattern."""
        return [
            exchange
            for exchange in self._exchanges[since:]
            if method in (None, exchange.method)
            and status in (None, exchange.status)
            and re.search(path, exchange.path)
        ]

    def uploaded(self, since: int = 0) -> list[str]:
        """Return the SHA-256 of each content that was sent, as often as it was."""
        return [each.path.rpartition("/")[2] for each in self.find("PUT", "^/lfs/", 200, since)]
