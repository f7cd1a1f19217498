"""Object stores: one in memory, and moto's S3 on loopback with faults that a test chooses."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

import fsspec
import pytest
from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import make_server

from labyrinth_core.remote import RemotePath

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


@pytest.fixture
def memory() -> Iterator[str]:
    """The URL of a folder in memory, whose name looks like a pattern."""
    name = uuid4().hex
    yield f"memory://{name}/run [5x5]*"
    filesystem = fsspec.filesystem("memory")
    if filesystem.exists(f"/{name}"):
        filesystem.rm(f"/{name}", recursive=True)


@pytest.fixture(scope="module")
def server() -> Iterator[S3Server]:
    with serving() as (server, address), pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", address)
        patch.setenv("AWS_ACCESS_KEY_ID", "nobody")
        patch.setenv("AWS_SECRET_ACCESS_KEY", "nothing")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        fsspec.get_filesystem_class("s3").clear_instance_cache()  # Of another server's address.
        yield server


@pytest.fixture
def bucket(server: S3Server) -> Iterator[str]:
    """The URL of a folder in a new bucket, whose name looks like a pattern."""
    name = uuid4().hex
    fsspec.filesystem("s3", use_listings_cache=False).mkdir(name)
    server.requests.clear()
    yield f"s3://{name}/run [5x5]*"
    server.fault = lambda _method, _path: False


def content_of(folder: Path | RemotePath) -> dict[str, bytes]:
    """Return the content of all files of a folder, and of those in it."""
    files = [*folder.glob("*"), *folder.glob("*/*"), *folder.glob(".*"), *folder.glob(".*/*")]
    prefix = len(str(folder)) + 1
    return {str(p)[prefix:].replace("\\", "/"): p.read_bytes() for p in files if p.is_file()}
