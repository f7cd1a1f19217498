"""A Hub on loopback that can be started, stopped and looked into."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hub.faults import Faults
from hub.request_log import RequestLog
from hub.server import Listener
from hub.state import MAIN, TOKENS, Commit, Entry, HubState, Repository

FOREIGN_SETTINGS = ("HF_", "HUGGING", "TRANSFORMERS_", "DATASETS_")
PROXIES = ("http_proxy", "https_proxy", "all_proxy")
SETTINGS = {
    "HF_DATASETS_DISABLE_PROGRESS_BARS": "1",
    "HF_DATASETS_OFFLINE": "0",
    "HF_HUB_DISABLE_PROGRESS_BARS": "1",
    "HF_HUB_DISABLE_TELEMETRY": "1",
    "HF_HUB_DISABLE_UPDATE_CHECK": "1",
    "HF_HUB_DISABLE_XET": "1",
    "HF_HUB_OFFLINE": "0",
    "HF_UPDATE_DOWNLOAD_COUNTS": "0",
    "NO_PROXY": "127.0.0.1,localhost",
}


class LocalHub:
    """A Hub on loopback, whose state is in a folder.

    Args:
        folder: Where the state is kept; a Hub that was there before goes on.
        port: The port; 0 for any that is free.
        user: The user of the tokens `write` and `read`.
        organizations: Those of which that user is a member.
    """

    def __init__(
        self,
        folder: Path,
        port: int = 0,
        user: str = "user",
        organizations: tuple[str, ...] = ("lab",),
    ) -> None:
        self.folder = folder
        self._homes = 0
        self._state = HubState(folder.absolute(), user, organizations)
        self._listener = Listener(self._state, port)
        self._state.url = self.url

    def __enter__(self) -> LocalHub:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def url(self) -> str:
        """What `HF_ENDPOINT` has to be."""
        return f"http://127.0.0.1:{self._listener.server_address[1]}"

    @property
    def log(self) -> RequestLog:
        """All requests and their answers."""
        return self._state.log

    @property
    def faults(self) -> Faults:
        """What goes wrong on demand."""
        return self._state.faults

    @property
    def failures(self) -> list[str]:
        """Tracebacks of errors of this server itself; empty if all is well."""
        return self._listener.failures

    @property
    def collections(self) -> list[dict[str, Any]]:
        """All collections."""
        return list(self._state.collections.values())

    def stop(self) -> None:
        """Stop answering; the state stays in the folder."""
        self.faults.clear()
        self._listener.shutdown()
        self._listener.server_close()

    def wait_until_quiet(self, seconds: float = 10.0) -> None:
        """Wait until no request is being answered, such as those of a client that was killed.

        Raises:
            TimeoutError: That takes longer.
        """
        if not self._listener.wait_until_quiet(seconds):
            raise TimeoutError(f"{self._listener.in_flight} requests go on after {seconds} s")

    def env(self, token: str | None = "write", home: Path | None = None) -> dict[str, str]:
        """Return the environment of a process that is to talk to this Hub.

        Args:
            token: Label of the token: `write`, `read`, `stranger`, `rejected`; None for none.
            home: For caches and settings; None for a new and empty folder.
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
        return environment | ({} if token is None else {"HF_TOKEN": TOKENS[token]})

    def create_repo(self, name: str, private: bool = False, kind: str = "dataset") -> None:
        """Make a repository, as its owner would have before."""
        with self._state.lock:
            self._state.create(kind, name, private)

    def has(self, name: str, kind: str = "dataset") -> bool:
        """Return whether there is a repository."""
        return (kind, name) in self._state.repositories

    def commit(
        self, name: str, path: str = "NEWS.md", content: bytes = b"news", kind: str = "dataset"
    ) -> Commit:
        """Return a commit to `main` by another user."""
        with self._state.lock:
            repository = self._repository(name, kind)
            entry = self._state.regular_entry(content)
            tree = {**repository.find("main").tree, path: entry}
            return repository.commit(MAIN, tree, f"Change {path}")

    def tag(self, name: str, tag: str, kind: str = "dataset") -> None:
        """Let a tag point at the head of `main`."""
        repository = self._repository(name, kind)
        repository.refs[f"refs/tags/{tag}"] = repository.refs[MAIN]

    def merge(self, name: str, number: int) -> str:
        """Return the commit of a pull request, which `main` is moved to."""
        repository = self._repository(name, "dataset")
        repository.refs[MAIN] = repository.refs[f"refs/pr/{number}"]
        return repository.refs[MAIN]

    def refs(self, name: str, kind: str = "dataset") -> dict[str, str]:
        """Return the commit of every full ref, such as `refs/tags/1.0.0`."""
        return dict(self._repository(name, kind).refs)

    def tree(self, name: str, revision: str = "main", kind: str = "dataset") -> Mapping[str, Entry]:
        """Return the files of a revision by their paths."""
        return self._repository(name, kind).find(revision).tree

    def history(self, name: str, kind: str = "dataset") -> list[Commit]:
        """Return the commits up to the head of `main`, newest first."""
        repository = self._repository(name, kind)
        return list(repository.history(repository.find("main")))

    def blob(self, sha256: str) -> Path:
        """Return the file in which a content is stored."""
        return self._state.blobs / sha256

    def content(self, name: str, path: str, revision: str = "main", kind: str = "dataset") -> bytes:
        """Return the content of a file."""
        return self.blob(self.tree(name, revision, kind)[path].sha256).read_bytes()

    def _repository(self, name: str, kind: str) -> Repository:
        return self._state.repositories[kind, name]
