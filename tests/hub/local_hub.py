"""A Hub on loopback that can be started, stopped and started again, and looked into."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

from hub.accounts import make_accounts, token_of
from hub.faults import Faults
from hub.handler import Handler
from hub.listener import Listener
from hub.repositories import Commit, Entry, Repository
from hub.request_log import RequestLog
from hub.state import HubState

PART_SIZE = 16384
"""Bytes of a part in `lfs-multipart`: small, so that small files have several."""
FOREIGN_SETTINGS = ("HF_", "HUGGING", "TRANSFORMERS_", "DATASETS_")
PROXIES = ("http_proxy", "https_proxy", "all_proxy")
# hf-xet repeats a call five times; by its own base delay that takes three minutes.
SETTINGS = {
    "HF_DATASETS_DISABLE_PROGRESS_BARS": "1",
    "HF_DATASETS_OFFLINE": "0",
    "HF_HUB_DISABLE_PROGRESS_BARS": "1",
    "HF_HUB_DISABLE_TELEMETRY": "1",
    "HF_HUB_DISABLE_UPDATE_CHECK": "1",
    "HF_HUB_OFFLINE": "0",
    "HF_UPDATE_DOWNLOAD_COUNTS": "0",
    "HF_XET_CLIENT_RETRY_BASE_DELAY": "100ms",
    "NO_PROXY": "127.0.0.1,localhost",
}


class LocalHub:
    """A Hub on loopback, whose state is in a folder.

    Args:
        folder: where the state is kept; a Hub that was here before goes on.
        mode: how contents are uploaded: `xet`, `lfs-basic` or `lfs-multipart`.
        port: of the Hub itself; 0 for any that is free.
        user: whose the tokens `write` and `read` are.
        organizations: of which that user is a member.
        part_size: bytes of a part in `lfs-multipart`.
    """

    def __init__(
        self,
        folder: Path,
        mode: str = "xet",
        port: int = 0,
        part_size: int = PART_SIZE,
        user: str = "user",
        organizations: tuple[str, ...] = ("lab",),
    ) -> None:
        self.folder = folder
        self._homes = 0
        self._state = HubState(
            folder.absolute(), mode, make_accounts(user, organizations), part_size
        )
        self._start(port, 0)

    def __enter__(self) -> LocalHub:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    @property
    def url(self) -> str:
        """What `HF_ENDPOINT` has to be."""
        return self._state.url

    @property
    def mode(self) -> str:
        """How contents are uploaded."""
        return self._state.mode

    @property
    def log(self) -> RequestLog:
        """All requests and their answers, since the folder was made."""
        return self._state.log

    @property
    def faults(self) -> Faults:
        """What goes wrong on demand."""
        return self._state.faults

    @property
    def failures(self) -> list[str]:
        """Tracebacks of errors of this server itself; empty if all is well."""
        return [*self._hub.failures, *self._cdn.failures]

    def stop(self) -> None:
        """Stop answering; the state stays in the folder."""
        self.faults.clear()
        self._hub.stop()
        self._cdn.stop()

    def restart(self, mode: str | None = None) -> None:
        """Stop, forget all but the folder, and start again at the same address.

        Faults are gone then.
        """
        self.stop()
        ports = self._hub.server_address[1], self._cdn.server_address[1]
        state = self._state
        self._state = HubState(state.folder, mode or state.mode, state.accounts, state.part_size)
        self._start(*ports)

    def wait_until_quiet(self, seconds: float = 10.0) -> None:
        """Wait until no request is being answered, such as those of a client that was killed.

        Raises:
            TimeoutError: if that takes longer.
        """
        for listener in (self._hub, self._cdn):
            if not listener.wait_until_quiet(seconds):
                raise TimeoutError(f"{listener.in_flight} requests go on after {seconds} s")

    def env(self, token: str | None = "write", home: Path | None = None) -> dict[str, str]:
        """Return the environment of a process that is to talk to this Hub.

        Args:
            token: label of the token: `write`, `read`, `stranger`, `rejected`; None for none.
            home: for caches and settings; None for a new and empty folder.
        """
        if home is None:
            self._homes += 1
            home = self.folder / "homes" / str(self._homes)
        kept = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith(FOREIGN_SETTINGS) and name.lower() not in PROXIES
        }
        environment = kept | SETTINGS | {"HF_ENDPOINT": self.url, "HF_HOME": str(home)}
        environment["HF_HUB_DISABLE_XET"] = "0" if self.mode == "xet" else "1"
        if token is not None:
            environment["HF_TOKEN"] = token_of(token)
        return environment

    def run(
        self,
        script: str,
        *arguments: str | Path,
        token: str | None = "write",
        home: Path | None = None,
        seconds: float = 120.0,
        check: bool = True,
    ) -> subprocess.CompletedProcess[str]:
        """Return what became of a Python script run in a fresh process against this Hub.

        Raises:
            RuntimeError: if it fails, unless `check` is False; with what it wrote.
        """
        done = subprocess.run(
            [sys.executable, "-c", script, *map(str, arguments)],
            env=self.env(token, home),
            capture_output=True,
            text=True,
            timeout=seconds,
        )
        if check and done.returncode != 0:
            raise RuntimeError(f"script ended with {done.returncode}\n{done.stdout}{done.stderr}")
        return done

    def create_repo(self, name: str, private: bool = False, kind: str = "dataset") -> None:
        """Make a repository, as its owner would have before."""
        with self._state.lock:
            self._state.create_repository(kind, name, private, name.split("/")[0])

    def commit(
        self, name: str, path: str = "NEWS.md", content: bytes | None = None, kind: str = "dataset"
    ) -> Commit:
        """Return a commit to `main` by somebody else."""
        with self._state.lock:
            repository = self._repository(name, kind)
            return self._state.commit_as_somebody_else(repository, path, content)

    def tag(self, name: str, tag: str, revision: str = "main", kind: str = "dataset") -> None:
        """Let a tag point at a revision, wherever it pointed before."""
        with self._state.lock:
            repository = self._repository(name, kind)
            repository.point(f"refs/tags/{tag}", repository.find(revision).oid)

    def refs(self, name: str, kind: str = "dataset") -> dict[str, str]:
        """Return the commit of every full ref, such as `refs/tags/1.0.0`."""
        return dict(self._repository(name, kind).refs)

    def tree(self, name: str, revision: str = "main", kind: str = "dataset") -> Mapping[str, Entry]:
        """Return the files of a revision by their paths."""
        return self._repository(name, kind).find(revision).tree

    def history(self, name: str, revision: str = "main", kind: str = "dataset") -> list[Commit]:
        """Return the commits up to a revision, newest first."""
        repository = self._repository(name, kind)
        return list(repository.history(repository.find(revision)))

    def content(self, name: str, path: str, revision: str = "main", kind: str = "dataset") -> bytes:
        """Return the content of a file."""
        return self._state.content(self.tree(name, revision, kind)[path])

    def stored_bytes(self) -> int:
        """Return the bytes hf-xet has stored: a rerun that sends nothing new adds none."""
        return self._state.blobs.xet.size()

    def _repository(self, name: str, kind: str) -> Repository:
        repository = self._state.repository(kind, name)
        if repository is None:
            known = ", ".join(each.name for each in self._state.repositories())
            raise ValueError(f"repository is {name!r}; there are: {known or 'none'}")
        return repository

    def _start(self, port: int, cdn_port: int) -> None:
        self._hub = Listener(self._state, "hub", port, Handler)
        self._cdn = Listener(self._state, "cdn", cdn_port, Handler)
        self._state.url, self._state.cdn_url = self._hub.url, self._cdn.url
        self._hub.start()
        self._cdn.start()
