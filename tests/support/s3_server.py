"""moto's S3, served on loopback, with a fault for the requests that a test chooses."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import make_server

Fault = Callable[[str, str], bool]

DENIED = b"<?xml version='1.0'?><Error><Code>AccessDenied</Code><Message>quota</Message></Error>"


class S3Server:
    """A store in memory; requests for which `fault(method, path)` is true are denied."""

    def __init__(self) -> None:
        self.fault: Fault = lambda _method, _path: False
        self.requests: list[tuple[str, str]] = []
        self._moto: Any = DomainDispatcherApplication(create_backend_app)

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        method, path = environ["REQUEST_METHOD"], environ["PATH_INFO"]
        self.requests.append((method, path))
        if self.fault(method, path):
            # What is sent must be read before the answer, or the client may never see it.
            environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
            start_response("403 Forbidden", [("Content-Type", "application/xml")])
            return [DENIED]
        return self._moto(environ, start_response)  # type: ignore[no-any-return]


@contextmanager
def serving() -> Iterator[tuple[S3Server, str]]:
    """Lend a server and its address."""
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    application = S3Server()
    server = make_server("127.0.0.1", 0, application, threaded=True)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield application, f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
