"""The port on which the Hub on loopback listens: reads requests, lets faults strike, answers."""

from __future__ import annotations

import json
import socket
import sys
import threading
import traceback
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

import hub.calls  # noqa: F401  Its functions answer the calls.
from hub.faults import Rule
from hub.routing import Answer, RefusalError, Request, answer, as_json
from hub.state import Exchange

if TYPE_CHECKING:
    from hub.local_hub import LocalHub

CHUNK = 1 << 16
CONTROL = "/__control__"


class DroppedError(RuntimeError):
    """The connection is to be closed without an answer."""


class Listener(ThreadingHTTPServer):
    """The port of the Hub, with a thread for each connection."""

    daemon_threads = True
    request_queue_size = 128

    def __init__(self, hub: LocalHub, port: int) -> None:
        self.hub = hub
        self.in_flight = 0
        self.changed = threading.Condition()
        super().__init__(("127.0.0.1", port), Handler)
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
        url, hub = urlsplit(self.path), self.server.hub
        body = self._body()
        if url.path == CONTROL:
            self._send(self._control(b"".join(body)))
            return
        token = self.headers.get("Authorization", "").removeprefix("Bearer ")
        account = hub.accounts.get(token)
        request = Request(self.command, url.path, url.query, self.headers, account, lambda: body)
        label = account.label if account else "rejected" if token else "none"
        try:
            told = self._answer(request)
            for _ in body:
                continue
        except (DroppedError, ConnectionError):
            hub.log.add(Exchange(self.command, unquote(url.path), 0, label))
            self.close_connection = True
            self.connection.shutdown(socket.SHUT_RDWR)
            return
        sent = 0 if self.command == "HEAD" else len(told.body)
        hub.log.add(Exchange(self.command, unquote(url.path), told.status, label, sent))
        self._send(told)

    def _answer(self, request: Request) -> Answer:
        """Return the answer to a request, after the faults that strike it."""
        rules = self.server.hub.faults.take(request.method, request.path)
        for rule in rules:
            if rule.effect == "hold" and not rule.after:
                request.body()
                self._hold(rule)
            if not rule.after:
                rule.reached.set()
            if rule.effect == "fail":
                message = f"the Hub answers {rule.status} on demand"
                return RefusalError(rule.status, message).answer
            if rule.effect == "drop":
                raise DroppedError
        try:
            told = answer(self.server.hub, request)
        except RefusalError as refusal:
            told = refusal.answer
        except (DroppedError, ConnectionError):
            raise
        except Exception:
            self.server.hub.failures.append(traceback.format_exc())
            told = RefusalError(500, "Internal Server Error").answer
        for rule in rules:
            if rule.effect == "hold" and rule.after:
                self._hold(rule)
            if rule.effect == "stall":
                told.before_the_rest = rule.released.wait
            if rule.effect == "lose response":
                raise DroppedError
        return told

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
            self.wfile.write(told.body[half:])

    def _control(self, body: bytes) -> Answer:
        """Change the faults, as another process asks."""
        try:
            self.server.hub.faults.control(json.loads(body))
        except ValueError as error:
            return RefusalError(400, str(error)).answer
        return as_json({})
