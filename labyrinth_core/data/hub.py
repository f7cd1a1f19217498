"""How long a call of the Hub's client may wait: a minute without a byte, and once more.

The client itself sets no limit for most of its calls, ten seconds for others, and repeats some of
them five times. All go through one HTTP session, which sets the limit here. Contents of large files
go through Xet's own client, which takes it from environment variables.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

from huggingface_hub import set_client_factory
from huggingface_hub.errors import HTTPError  # type: ignore[attr-defined]
from huggingface_hub.utils import _http

from labyrinth_core.data.errors import DatasetError

if TYPE_CHECKING:
    from huggingface_hub.utils import httpx  # type: ignore[attr-defined]
else:  # The library that the client makes its calls with: httpx2 in its later versions.
    httpx = getattr(_http, "httpx2", None) or _http.httpx

VARIABLE, SECONDS = "LABYRINTH_HUB_SECONDS", "60"
"""The environment variable with the seconds without a byte that end a call, and its default."""

NOTICE = 1 / 6
"""The part of that time in which a line says what is awaited."""

REPEATABLE = ("GET", "HEAD")
"""Methods that are sent again here. Only who sends another knows whether it may be done twice."""


UNAVAILABLE = (OSError, ValueError, HTTPError, RuntimeError)
"""What the client raises for a file or a repository that it cannot provide; the last one: Xet's."""

_announced: ContextVar[bool] = ContextVar("_announced", default=False)


class SilentHubError(HTTPError, OSError):
    """The Hub sent nothing, twice. No client that is used here repeats a call after this error."""


def limit_silence() -> None:
    """Limit how long later calls of the Hub's client wait, unless its sessions are a user's own.

    Raises:
        DatasetError: The environment variable holds no number of seconds.
    """
    if _http._GLOBAL_CLIENT_FACTORY is _http.default_client_factory:
        seconds = _seconds()
        set_client_factory(lambda: _Session(seconds))
        for name in ("CONNECT_TIMEOUT", "READ_TIMEOUT"):
            os.environ.setdefault(f"HF_XET_CLIENT_{name}", f"{1000 * seconds:.0f}ms")
        os.environ.setdefault("HF_XET_CLIENT_RETRY_MAX_ATTEMPTS", "1")


@contextmanager
def announced(what: str) -> Iterator[None]:
    """Say what is awaited, within ten seconds, in place of the names of the calls within."""
    call = _Call(what, _seconds(), set())
    token = _announced.set(True)
    try:
        yield
    finally:
        _announced.reset(token)
        call.ended.set()


def _seconds() -> float:
    text = os.environ.get(VARIABLE, SECONDS)
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0 < seconds < 1e6:
        raise DatasetError(f"{VARIABLE}={text:.60}: give a number of seconds, such as {SECONDS}")
    return seconds


class _Session(httpx.Client):
    """The client's HTTP session, with a limit on how long the Hub may send nothing."""

    def __init__(self, seconds: float) -> None:
        default = _http.default_client_factory()
        super().__init__(event_hooks=default.event_hooks, follow_redirects=default.follow_redirects)
        self._seconds = seconds
        self._silent: set[str] = set()

    def send(self, request: Any, *, stream: bool = False, **options: Any) -> Any:
        """Send a request, and send it again if nothing comes and it may be repeated."""
        request.extensions["timeout"] = httpx.Timeout(self._seconds).as_dict()
        name = f"{request.method} {request.url.copy_with(query=None)}"  # A query may have keys.
        call, response = _Call(name, self._seconds, self._silent), None
        if not isinstance(request.stream, httpx.ByteStream):
            request.stream = _Sent(request.stream, call)
        try:
            response = super().send(request, stream=True, **options)
            call.waiting, response.stream = False, _Received(response.stream, call)
            if not stream:
                response.read()
            return response
        except BaseException as error:
            if response is not None:
                response.close()
            call.ended.set()
            if not isinstance(error, httpx.TimeoutException):
                raise
            if response is None:
                call.unanswered()
            if request.method not in REPEATABLE:
                raise
        return self.send(request, stream=stream, **options)


class _Call:
    """A call under way, which says what it waits for when nothing comes."""

    def __init__(self, name: str, seconds: float, silent: set[str]) -> None:
        """Begin to wait.

        Args:
            name: Method and address.
            seconds: After how many seconds without a byte it ends.
            silent: The names of the calls that ended so the last time.
        """
        self.waiting, self.moves, self.ended = True, 0, Event()
        self._name, self._seconds, self._silent = name, seconds, silent
        if name not in silent and not _announced.get():
            Thread(target=self._watch, name="waiting for the Hub", daemon=True).start()

    def _watch(self) -> None:
        moves = -1
        while not self.ended.wait(self._seconds * NOTICE / 2):
            if self.waiting and self.moves == moves:
                limit = f"the call ends after {self._seconds:g} seconds without a byte, twice"
                sys.stderr.write(f"waiting for the Hub: {self._name} ({limit})\n")
                return
            moves = self.moves

    def answered(self) -> None:
        self._silent.discard(self._name)

    def unanswered(self) -> None:
        """Take note that nothing came; raise SilentHubError if it is for the second time."""
        if self._name in self._silent:
            self._silent.discard(self._name)
            reason = f"the Hub sent nothing for {self._seconds:g} seconds, twice"
            raise SilentHubError(f"{reason}: {self._name}")
        self._silent.add(self._name)


class _Sent(httpx.SyncByteStream):
    """The body of a request, in pieces."""

    def __init__(self, pieces: Any, call: _Call) -> None:
        self._pieces, self._call = pieces, call

    def __iter__(self) -> Iterator[bytes]:
        for piece in self._pieces:
            self._call.moves += 1
            yield piece


class _Received(_Sent):
    """The body of an answer; between its pieces the caller may take any time."""

    def __iter__(self) -> Iterator[bytes]:
        self._call.waiting = True
        try:
            for piece in super().__iter__():
                self._call.waiting = False
                yield piece
                self._call.waiting = True
        except httpx.TimeoutException:
            self._call.unanswered()
            raise
        self._call.answered()  # In whole: half an answer, again and again, counts as silence.

    def close(self) -> None:
        self._call.ended.set()
        self._pieces.close()
