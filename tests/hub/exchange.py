"""What the answering functions are given and give: requests, answers, refusals, routes."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from email.message import Message
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote

from hub.accounts import Account
from hub.repositories import Commit, Repository, UnknownRevisionError
from hub.state import HubState


@dataclass
class Request:
    """A request, of which the body has not been read."""

    method: str
    raw_path: str
    """As it came, quoted, without the query."""
    raw_query: str
    headers: Message
    origin: str
    """`hub` or `cdn`."""
    account: Account | None
    token: str
    """Label of the token, `none` or `rejected`."""
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
        if content:
            self.chunks = lambda: iter([content])
        return content

    def json(self) -> Any:
        """Return the body, which has to be JSON.

        Raises:
            RefusalError: with 400, if it is not.
        """
        try:
            return json.loads(self.body() or b"{}")
        except ValueError as error:
            raise RefusalError(400, f"body is not JSON: {error}") from error


@dataclass
class Answer:
    """An answer; the body is in memory, or a part of a file."""

    status: int = 200
    body: bytes = b""
    headers: dict[str, str] = field(default_factory=dict)
    file: Path | None = None
    start: int = 0
    size: int | None = None
    """Number of bytes of the body, if it comes from a file, or is that of a HEAD."""


class RefusalError(RuntimeError):
    """The Hub does not do what is asked, as the client's `hf_raise_for_status` reads it."""

    def __init__(
        self, status: int, message: str, code: str | None = None, **headers: str | int
    ) -> None:
        super().__init__(message)
        self.status = status
        self.message = message
        self.headers = {name.replace("_", "-"): str(value) for name, value in headers.items()}
        self.headers["X-Error-Message"] = message
        if code is not None:
            self.headers["X-Error-Code"] = code

    def answer(self) -> Answer:
        """Return the answer that tells the client."""
        return as_json({"error": self.message}, self.status, self.headers)


def as_json(value: Any, status: int = 200, headers: Mapping[str, str] | None = None) -> Answer:
    """Return an answer with JSON."""
    content_type = {"Content-Type": "application/json; charset=utf-8"}
    return Answer(status, json.dumps(value).encode(), content_type | dict(headers or {}))


Answering = Callable[..., Answer]
ROUTES: list[tuple[str, re.Pattern[str], Answering]] = []
"""Method, pattern of the quoted path, and the function that answers."""

REPO = r"/api/(?P<kind>dataset|model|space)s/(?P<name>[^/]+/[^/]+)"
"""Beginning of the paths about a repository."""


def route(method: str, pattern: str) -> Callable[[Answering], Answering]:
    """Return a decorator: the function answers such calls; named groups become arguments."""

    def register(function: Answering) -> Answering:
        ROUTES.append((method, re.compile(pattern), function))
        return function

    return register


def find_route(request: Request) -> tuple[Answering, dict[str, str]] | None:
    """Return the function that answers a request, with its arguments, None if there is none."""
    method = "GET" if request.method == "HEAD" else request.method
    for allowed, pattern, function in ROUTES:
        if allowed == method and (match := pattern.fullmatch(request.raw_path)):
            groups = match.groupdict()
            return function, {name: unquote(value or "") for name, value in groups.items()}
    return None


def visible(hub: HubState, request: Request, kind: str, name: str) -> Repository:
    """Return a repository.

    Raises:
        RefusalError: if there is none, or it is private and of others: with 401 to those without a
            token and 404 to those with one.
    """
    repository = hub.repository(kind, name)
    account = request.account
    if repository is not None and not repository.private:
        return repository
    if account is None:
        raise RefusalError(401, "Invalid username or password.", "RepoNotFound")
    if repository is None or not account.may_read(name, repository.private):
        raise RefusalError(404, "Repository not found", "RepoNotFound")
    return repository


def writable(
    hub: HubState, request: Request, kind: str, name: str, create_pr: bool = False
) -> Repository:
    """Return a repository that the token may change, or propose changes to.

    Raises:
        RefusalError: as `visible` does, with 401 without a token, with 403 without the right.
    """
    repository = visible(hub, request, kind, name)
    account = request.account
    if account is None:
        raise RefusalError(401, "Invalid username or password.")
    if account.role != "write":
        raise RefusalError(403, "Authorization error: this token may read, not write")
    if not account.may_write(name) and not create_pr:
        message = "Forbidden: pass `create_pr=1` as a query parameter to create a Pull Request"
        raise RefusalError(403, message)
    return repository


def find_commit(repository: Repository, revision: str) -> Commit:
    """Return the commit that a revision means.

    Raises:
        RefusalError: with 404, if there is none.
    """
    try:
        return repository.find(revision)
    except UnknownRevisionError as error:
        raise RefusalError(404, str(error), "RevisionNotFound") from error
