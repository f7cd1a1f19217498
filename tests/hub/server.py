"""The port on which the Hub on loopback listens: reads requests, lets faults strike, answers.

A refusal is what the client's `hf_raise_for_status` reads. The client maps some errors by the
header `X-Error-Code` alone where it speaks plain http.
"""

from __future__ import annotations

import json
import re
import socket
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, unquote, urlsplit

from hub.faults import Rule
from hub.state import MAIN, Account, Exchange

if TYPE_CHECKING:
    from hub.local_hub import LocalHub

CHUNK = 1 << 16
CONTROL = "/__control__"


@dataclass
class Answer:
    """An answer of the Hub."""

    status: int = 200
    body: bytes = b""
    headers: dict[str, str] = field(default_factory=dict)
    before_the_rest: Callable[[], object] = lambda: None
    """Called when half of the body has been sent."""


class RefusalError(RuntimeError):
    """The Hub does not do what is asked."""

    def __init__(self, status: int, message: str, code: str = "") -> None:
        super().__init__(message)
        headers = {"X-Error-Message": message} | ({"X-Error-Code": code} if code else {})
        self.answer = as_json({"error": message}, status, headers)


class DroppedError(RuntimeError):
    """The connection is to be closed without an answer."""


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


class Listener(ThreadingHTTPServer):
    """The port of the Hub, with a thread for each connection."""

    daemon_threads = True
    request_queue_size = 128

    def __init__(self, hub: LocalHub, port: int) -> None:
        self.hub = hub
        self.in_flight = 0
        self.changed = threading.Condition()
        super().__init__(("127.0.0.1", port), Request)
        threading.Thread(target=self.serve_forever, args=(0.02,), daemon=True).start()

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ARG002
        if not isinstance(sys.exc_info()[1], ConnectionError):
            self.hub.failures.append(traceback.format_exc())

    def count(self, change: int) -> None:
        """Count a request that begins or ends."""
        with self.changed:
            self.in_flight += change
            self.changed.notify_all()

    def wait_until_quiet(self, seconds: float) -> bool:
        """Return whether, within a time, no request is being answered."""
        with self.changed:
            return self.changed.wait_for(lambda: self.in_flight == 0, seconds)


class Request(BaseHTTPRequestHandler):
    """The requests of one connection, one after the other."""

    server: Listener
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    account: Account | None
    """Of the token; None without one, or for one that the Hub does not know."""
    raw_path: str
    """As it came, quoted, without the query."""
    query: dict[str, list[str]]
    """The values of each argument in the query."""
    chunks: Iterator[bytes]
    """The rest of the body, as it arrives."""

    def flag(self, name: str) -> bool:
        """Return whether an argument in the query is true."""
        return self.query.get(name, ["0"])[0].lower() in ("1", "true")

    def body(self) -> bytes:
        """Return the whole body, however often it is asked for."""
        content = b"".join(self.chunks)
        self.chunks = iter([content])
        return content

    def json(self) -> Any:
        """Return the body, which has to be JSON."""
        try:
            return json.loads(self.body() or b"{}")
        except ValueError as error:
            raise RefusalError(400, f"body is not JSON: {error}") from error

    def handle_one_request(self) -> None:
        self.raw_requestline = self.rfile.readline(CHUNK + 1)
        if not self.raw_requestline or not self.parse_request():
            self.close_connection = True
            return
        self.server.count(+1)
        try:
            self._answer_request()
        finally:
            self.server.count(-1)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Print nothing: the request log has it all."""

    def _answer_request(self) -> None:
        url, hub = urlsplit(self.path), self.server.hub
        self.raw_path, self.query, self.chunks = url.path, parse_qs(url.query), self._body()
        if url.path == CONTROL:
            self._send(self._control())
            return
        token = self.headers.get("Authorization", "").removeprefix("Bearer ")
        self.account = hub.accounts.get(token)
        label = self.account.label if self.account else "rejected" if token else "none"
        try:
            told = self._after_faults()
            self.body()
        except (DroppedError, ConnectionError):
            hub.log.add(Exchange(self.command, unquote(url.path), 0, label))
            self.close_connection = True
            self.connection.shutdown(socket.SHUT_RDWR)
            return
        sent = 0 if self.command == "HEAD" else len(told.body)
        hub.log.add(Exchange(self.command, unquote(url.path), told.status, label, sent))
        self._send(told)

    def _after_faults(self) -> Answer:
        """Return the answer to the request, after the faults that strike it."""
        rules = self.server.hub.faults.take(self.command, unquote(self.raw_path))
        for rule in rules:
            if rule.effect == "hold" and not rule.after:
                self.body()
                self._hold(rule)
            if not rule.after:
                rule.reached.set()
            if rule.effect == "fail":
                message = f"the Hub answers {rule.status} on demand"
                refused = RefusalError(rule.status, message).answer
                refused.headers.update(rule.headers)
                return refused
            if rule.effect == "answer" and not rule.after:
                return Answer(rule.status, rule.body, dict(rule.headers))
            if rule.effect == "drop":
                raise DroppedError
            if rule.effect == "intrude" and not rule.after:
                self._intrude()
        try:
            stale = any(rule.effect == "stale" for rule in rules)
            told = self._answer_as_before() if stale else self._answer()
        except RefusalError as refusal:
            told = refusal.answer
        except (DroppedError, ConnectionError):
            raise
        except Exception:
            self.server.hub.failures.append(traceback.format_exc())
            told = RefusalError(500, "Internal Server Error").answer
        for rule in rules:
            if rule.after and rule.effect == "hold":
                self._hold(rule)
            if rule.effect == "stall":
                told.before_the_rest = rule.released.wait
            if rule.effect == "intrude" and rule.after:
                self._intrude()
            if rule.effect == "answer":
                rule.reached.set()
                told = Answer(rule.status, rule.body, dict(rule.headers))
            if rule.effect == "damage" and told.body:
                place = len(told.body) // 2
                wrong = bytes([told.body[place] ^ 1])
                told.body = told.body[:place] + wrong + told.body[place + 1 :]
            if rule.effect == "cut":
                told.before_the_rest = self._close
            if rule.effect == "lose response":
                raise DroppedError
        return told

    def _answer(self) -> Answer:
        """Return the answer to the request; refusals are raised."""
        if self.account is None and "Authorization" in self.headers:
            raise RefusalError(401, "Invalid credentials in Authorization header")
        method = "GET" if self.command == "HEAD" else self.command
        for allowed, pattern, function in ROUTES:
            if allowed == method and (match := pattern.fullmatch(self.raw_path)):
                groups = {name: unquote(value or "") for name, value in match.groupdict().items()}
                with self.server.hub.lock:
                    return function(self.server.hub, self, **groups)
        raise RefusalError(404, f"this Hub knows no call {self.command} {self.raw_path}")

    def _answer_as_before(self) -> Answer:
        """Return the answer that the request would have got before the newest commit."""
        with self.server.hub.lock:
            heads = []
            for repository in self.server.hub.repositories.values():
                head = repository.find("main")
                heads.append((repository, head.oid))
                repository.refs[MAIN] = head.parent or head.oid
            try:
                return self._answer()
            finally:
                for repository, head in heads:
                    repository.refs[MAIN] = head

    def _intrude(self) -> None:
        """Let another user commit to the repository that is asked about."""
        for kind, name in self.server.hub.repositories:
            if name in unquote(self.raw_path):
                self.server.hub.commit(name, kind=kind)
                return

    def _close(self) -> None:
        """Close the connection before the rest of an answer is sent."""
        self.wfile.flush()
        self.close_connection = True
        self.connection.shutdown(socket.SHUT_RDWR)

    def _hold(self, rule: Rule) -> None:
        """Wait for the release; drop the call if the client has gone in the meantime."""
        rule.reached.set()
        rule.released.wait()
        try:
            waiting = self.connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        if waiting == b"":
            raise DroppedError

    def _body(self) -> Iterator[bytes]:
        """Yield the body as it arrives."""
        for size in self._sizes():
            while size > 0:
                chunk = self.rfile.read(min(size, CHUNK))
                if not chunk:
                    raise DroppedError
                size -= len(chunk)
                yield chunk

    def _sizes(self) -> Iterator[int]:
        """Yield the sizes of the pieces in which the body is sent."""
        if self.headers.get("Transfer-Encoding", "").lower() != "chunked":
            yield int(self.headers.get("Content-Length", 0))
            return
        while size := int(self.rfile.readline().split(b";")[0] or b"0", 16):
            yield size
            self.rfile.readline()
        while self.rfile.readline().strip():
            continue

    def _send(self, told: Answer) -> None:
        self.send_response_only(told.status)
        for name, value in {**told.headers, "Content-Length": str(len(told.body))}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            half = len(told.body) // 2
            self.wfile.write(told.body[:half])
            told.before_the_rest()
            with suppress(ConnectionError) if self.close_connection else nullcontext():
                self.wfile.write(told.body[half:])

    def _control(self) -> Answer:
        """Change the faults, as another process asks."""
        try:
            self.server.hub.faults.control(json.loads(self.body()))
        except ValueError as error:
            return RefusalError(400, str(error)).answer
        return as_json({})
