"""Reads a request, lets faults strike, finds who answers, logs, and sends the answer."""

from __future__ import annotations

import json
import socket
import time
import traceback
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from hub import (  # noqa: F401  (each registers its routes)
    account_calls,
    collection_calls,
    commit_calls,
    downloading_calls,
    reading_calls,
    uploading_calls,
)
from hub.accounts import Account
from hub.exchange import Answer, RefusalError, Request, as_json, find_route
from hub.faults import Rule
from hub.listener import Listener, shut

CHUNK = 1 << 16
CONTROL = "/__control__"
LOG = "/__log__"


class DroppedError(RuntimeError):
    """The connection is to be closed without an answer."""


class Handler(BaseHTTPRequestHandler):
    """Answers the requests of one connection."""

    server: Listener
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True

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
        url = urlsplit(self.path)
        if url.path in (CONTROL, LOG):
            self._send(self._control(url.path, url.query))
            return
        self.received = 0
        self._body = self._read_body()
        account, token = self._identify()
        request = Request(
            self.command,
            url.path,
            url.query,
            self.headers,
            self.server.origin,
            account,
            token,
            lambda: self._body,
        )
        try:
            answer, rules = self._answer(request)
            for _ in self._body:
                continue
        except (DroppedError, ConnectionError):
            self._log(request, 0)
            self.close_connection = True
            shut(self.connection)
            return
        self._log(request, answer.status)
        self._send(answer)
        if any(rule.effect == "break after" for rule in rules):
            self.server.hub.faults.broken = True

    def _answer(self, request: Request) -> tuple[Answer, list[Rule]]:
        """Return the answer to a request, and the faults that struck it."""
        faults = self.server.hub.faults
        rules = faults.take(request.method, request.path)
        for rule in rules:
            if (answer := self._strike_before(request, rule)) is not None:
                return answer, rules
        if faults.broken:
            return RefusalError(500, "Internal Server Error").answer(), rules
        try:
            answer = self._dispatch(request)
        except RefusalError as refusal:
            answer = refusal.answer()
        except (DroppedError, ConnectionError):
            raise
        except Exception:
            self.server.failures.append(traceback.format_exc())
            answer = RefusalError(500, "Internal Server Error").answer()
        for rule in rules:
            if rule.effect == "hold after":
                rule.reached.set()
                self._hold(rule)
            if rule.effect == "lose response":
                if rule.status == 0:
                    raise DroppedError
                answer = RefusalError(rule.status, "the response was lost").answer()
        return answer, rules

    def _strike_before(self, request: Request, rule: Rule) -> Answer | None:
        """Let a fault strike before anything is done; return its answer, if it has one."""
        if not rule.effect.startswith("hold"):
            rule.reached.set()
        if rule.effect == "fail":
            extra = {} if rule.retry_after is None else {"Retry_After": rule.retry_after}
            message = rule.message or f"the Hub answers {rule.status} on demand"
            return RefusalError(rule.status, message, None, **extra).answer()
        if rule.effect == "drop":
            raise DroppedError
        if rule.effect == "delay":
            time.sleep(rule.seconds)
        if rule.effect == "hold":
            request.body()
            rule.reached.set()
            self._hold(rule)
        return None

    def _hold(self, rule: Rule) -> None:
        """Wait for the release; drop the call if the client has gone in the meantime."""
        rule.released.wait()
        if self._client_has_gone():
            raise DroppedError

    def _client_has_gone(self) -> bool:
        """Return whether the other end of the connection is closed."""
        try:
            waiting: bytes = self.connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except BlockingIOError:
            return False
        return waiting == b""

    def _dispatch(self, request: Request) -> Answer:
        """Return the answer of the function whose route this is."""
        if request.origin == "hub" and request.token == "rejected":
            raise RefusalError(401, "Invalid credentials in Authorization header")
        found = find_route(request)
        if found is None:
            raise RefusalError(404, f"this Hub knows no call {request.method} {request.path}")
        function, arguments = found
        return function(self.server.hub, request, **arguments)

    def _identify(self) -> tuple[Account | None, str]:
        """Return whose token came with the request, and what to call it in the log."""
        authorization = self.headers.get("Authorization", "")
        if not authorization:
            return None, "none"
        account = self.server.hub.account(authorization.removeprefix("Bearer "))
        return account, account.label if account else "rejected"

    def _read_body(self) -> Iterator[bytes]:
        """Yield the body as it arrives; slowly, where that is wanted of uploads.

        A client that is killed leaves in the sockets' buffers what it has sent, so a slow body is
        fetched at once, handed on slowly, and dropped when the client has gone.
        """
        faults = self.server.hub.faults
        if self.command != "PUT" or faults.put_chunk is None:
            yield from self._read_at_once()
            return
        size, body = faults.put_chunk, b"".join(self._read_at_once())
        self.received = 0
        for start in range(0, len(body), size):
            time.sleep(faults.put_seconds)
            if self._client_has_gone():
                raise DroppedError
            self.received += len(body[start : start + size])
            yield body[start : start + size]

    def _read_at_once(self) -> Iterator[bytes]:
        for size in self._pieces():
            while size > 0:
                chunk = self.rfile.read(min(size, CHUNK))
                if not chunk:
                    raise DroppedError
                size -= len(chunk)
                self.received += len(chunk)
                yield chunk

    def _pieces(self) -> Iterator[int]:
        """Yield the sizes of the pieces in which the body is sent."""
        if self.headers.get("Transfer-Encoding", "").lower() != "chunked":
            yield int(self.headers.get("Content-Length", 0))
            return
        while size := int(self.rfile.readline().split(b";")[0] or b"0", 16):
            yield size
            self.rfile.readline()
        while self.rfile.readline().strip():
            continue

    def _log(self, request: Request, status: int) -> None:
        self.server.hub.log.add(
            request.method,
            request.path,
            unquote(request.raw_query),
            status,
            self.received,
            request.token,
            request.origin,
        )

    def _send(self, answer: Answer) -> None:
        """Send an answer: what is small at once, files piece by piece."""
        self.send_response_only(answer.status)
        for name, value in answer.headers.items():
            self.send_header(name, value)
        size = len(answer.body) if answer.size is None else answer.size
        self.send_header("Content-Length", str(size))
        head = self.command == "HEAD"
        self.end_headers()
        if head:
            return
        self.wfile.write(answer.body)
        if answer.file is None:
            return
        with answer.file.open("rb") as file:
            file.seek(answer.start)
            while size > 0:
                chunk = file.read(min(size, CHUNK))
                self.wfile.write(chunk)
                size -= len(chunk)

    def _control(self, path: str, query: str) -> Answer:
        """Change the faults, or show them, or show the log from a number on."""
        hub = self.server.hub
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        if path == LOG:
            since = int(parse_qs(query).get("since", ["0"])[0])
            return as_json([vars(exchange) for exchange in hub.log.find(since=since)])
        try:
            if body:
                hub.faults.control(json.loads(body))
        except ValueError as error:
            return RefusalError(400, str(error)).answer()
        rules = [str(rule) for rule in hub.faults.rules if rule.times > 0]
        return as_json({"rules": rules, "broken": hub.faults.broken})
