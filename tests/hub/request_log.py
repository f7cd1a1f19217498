"""What was asked of the Hub and what it answered: kept in a file, queried by tests."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path


@dataclass(frozen=True)
class Exchange:
    """A request and its answer."""

    number: int
    method: str
    path: str
    """Unquoted, without the query."""
    query: str
    status: int
    """0 if the connection was dropped, by either side, before an answer."""
    received: int
    """Bytes of the request's body that arrived."""
    token: str
    """Label of the token; `none` without one, `rejected` if unknown."""
    origin: str
    """`hub`, or `cdn` for where contents are uploaded to and downloaded from."""

    def __str__(self) -> str:
        query = f"?{self.query}" if self.query and "Signature" not in self.query else ""
        status = self.status or "---"
        return f"{status} {self.method:6} {self.path}{query} ({self.token}, {self.received} bytes)"


class RequestLog:
    """All exchanges since the Hub's folder was made."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.on_exchange: Callable[[Exchange], None] | None = None
        self._lock = threading.Lock()
        self._exchanges: list[Exchange] = []
        if path.exists():
            lines = path.read_text(encoding="utf-8").splitlines()
            self._exchanges = [Exchange(**json.loads(line)) for line in lines]

    def __len__(self) -> int:
        """Return the number of exchanges: what is logged next has this number."""
        return len(self._exchanges)

    def __iter__(self) -> Iterator[Exchange]:
        return iter(self.find())

    def add(
        self,
        method: str,
        path: str,
        query: str,
        status: int,
        received: int,
        token: str,
        origin: str,
    ) -> None:
        """Keep an exchange."""
        with self._lock:
            number = len(self._exchanges)
            exchange = Exchange(number, method, path, query, status, received, token, origin)
            self._exchanges.append(exchange)
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(exchange)) + "\n")
            if self.on_exchange is not None:
                self.on_exchange(exchange)

    def find(
        self,
        method: str | None = None,
        path: str = "",
        status: int | None = None,
        since: int = 0,
        origin: str | None = None,
    ) -> list[Exchange]:
        """Return the exchanges with that method, status and origin whose path matches a pattern.

        Args:
            method: such as `PUT`; None for all.
            path: regular expression, searched in the path.
            status: such as 200; None for all.
            since: number of the first exchange wanted, as `len(log)` was at some time.
            origin: `hub` or `cdn`; None for both.
        """
        with self._lock:
            exchanges = self._exchanges[since:]
        return [
            exchange
            for exchange in exchanges
            if method in (None, exchange.method)
            and status in (None, exchange.status)
            and origin in (None, exchange.origin)
            and re.search(path, exchange.path)
        ]

    def uploaded(self, since: int = 0) -> list[Exchange]:
        """Return the uploads of contents that succeeded, part by part (not those through Xet)."""
        puts = self.find("PUT", since=since, origin="cdn")
        return [exchange for exchange in puts if exchange.status == 200]
