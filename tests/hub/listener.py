"""A port that the Hub listens on, with a thread for each connection."""

from __future__ import annotations

import socket
import sys
import threading
import traceback
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from hub.state import HubState


class Listener(ThreadingHTTPServer):
    """A port of the Hub: its own, or that of its CDN."""

    daemon_threads = False
    block_on_close = True
    request_queue_size = 128

    def __init__(
        self, hub: HubState, origin: str, port: int, handler: type[BaseHTTPRequestHandler]
    ) -> None:
        self.hub = hub
        self.origin = origin
        self.failures: list[str] = []
        """Tracebacks of what should not have happened in this server."""
        self.in_flight = 0
        self.changed = threading.Condition()
        self._connections: set[socket.socket] = set()
        super().__init__(("127.0.0.1", port), handler)
        self._thread = threading.Thread(target=self.serve_forever, args=(0.02,), name=origin)

    @property
    def url(self) -> str:
        """Where it listens."""
        return f"http://127.0.0.1:{self.server_address[1]}"

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def stop(self) -> None:
        """Close all connections and wait for all answers to end."""
        self.shutdown()
        self._thread.join()
        with self.changed:
            for connection in self._connections:
                shut(connection)
        self.server_close()

    def process_request(self, request: Any, client_address: Any) -> None:
        with self.changed:
            self._connections.add(request)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        with self.changed:
            self._connections.discard(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ARG002
        if not isinstance(sys.exc_info()[1], ConnectionError):
            self.failures.append(traceback.format_exc())

    def count(self, change: int) -> None:
        """Count a request that begins or ends."""
        with self.changed:
            self.in_flight += change
            self.changed.notify_all()

    def wait_until_quiet(self, seconds: float) -> bool:
        """Return whether, within a time, no request is being answered."""
        with self.changed:
            return self.changed.wait_for(lambda: self.in_flight == 0, seconds)


def shut(connection: socket.socket) -> None:
    """Close a connection for both sides, though a thread may be reading from it."""
    try:
        connection.shutdown(socket.SHUT_RDWR)
    except OSError:
        return
