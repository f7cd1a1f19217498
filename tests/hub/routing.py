"""Which function answers a call of the Hub on loopback, and the form of questions and answers.

A refusal is what the client's `hf_raise_for_status` reads. The client maps some errors by the
header `X-Error-Code` alone where it speaks plain http.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from email.message import Message
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, unquote

from hub.state import Account

if TYPE_CHECKING:
    from hub.local_hub import LocalHub


@dataclass
class Request:
    """A request, of which the body has not been read."""

    method: str
    raw_path: str
    """As it came, quoted, without the query."""
    raw_query: str
    headers: Message
    account: Account | None
    chunks: Callable[[], Iterator[bytes]]
    """Yields the rest of the body as it arrives."""

    @property
    def path(self) -> str:
        """The path, unquoted."""
        return unquote(self.raw_path)

    @property
    def query(self) -> dict[str, list[str]]:
        """The values of each argument in the query."""
        return parse_qs(self.raw_query)

    def flag(self, name: str) -> bool:
        """Return whether an argument in the query is true."""
        return self.query.get(name, ["0"])[0].lower() in ("1", "true")

    def body(self) -> bytes:
        """Return the whole body, however often it is asked for."""
        content = b"".join(self.chunks())
        self.chunks = lambda: iter([content])
        return content

    def json(self) -> Any:
        """Return the body, which has to be JSON."""
        try:
            return json.loads(self.body() or b"{}")
        except ValueError as error:
            raise RefusalError(400, f"body is not JSON: {error}") from error


@dataclass
class Answer:
    """An answer of the Hub."""

    status: int = 200
    body: bytes = b""
    headers: dict[str, str] = field(default_factory=dict)
    before_the_rest: Callable[[], None] = lambda: None
    """Called when half of the body has been sent."""


class RefusalError(RuntimeError):
    """The Hub does not do what is asked."""

    def __init__(self, status: int, message: str, code: str = "") -> None:
        super().__init__(message)
        headers = {"X-Error-Message": message} | ({"X-Error-Code": code} if code else {})
        self.answer = as_json({"error": message}, status, headers)


def as_json(value: Any, status: int = 200, headers: Mapping[str, str] | None = None) -> Answer:
    """Return an answer with JSON."""
    content_type = {"Content-Type": "application/json; charset=utf-8"}
    return Answer(status, json.dumps(value, default=str).encode(), content_type | (headers or {}))


Answering = Callable[..., Answer]
ROUTES: list[tuple[str, re.Pattern[str], Answering]] = []
"""Method, pattern of the quoted path, and the function that answers."""


def route(method: str, pattern: str) -> Callable[[Answering], Answering]:
    """Return a decorator: the function answers such calls; named groups become arguments."""

    def register(function: Answering) -> Answering:
        ROUTES.append((method, re.compile(pattern), function))
        return function

    return register


def answer(hub: LocalHub, request: Request) -> Answer:
    """Return the answer to a request; refusals are raised."""
    token = request.headers.get("Authorization", "").removeprefix("Bearer ")
    if token and request.account is None:
        raise RefusalError(401, "Invalid credentials in Authorization header")
    method = "GET" if request.method == "HEAD" else request.method
    for allowed, pattern, function in ROUTES:
        if allowed == method and (match := pattern.fullmatch(request.raw_path)):
            groups = {name: unquote(value or "") for name, value in match.groupdict().items()}
            with hub.lock:
                return function(hub, request, **groups)
    raise RefusalError(404, f"this Hub knows no call {request.method} {request.path}")
