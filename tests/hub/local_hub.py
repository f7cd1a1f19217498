"""A Hub on loopback: what it keeps, and what a test may do to it and see of it."""

from __future__ import annotations

import hashlib
import json
import os
import threading
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from uuid import uuid4

import hub.calls  # noqa: F401  Its functions answer the calls.
from hub.faults import Faults
from hub.server import Listener
from hub.state import MAIN, TOKENS, Account, Commit, Entry, Repository, RequestLog, git_oid

LFS_SUFFIXES = (".parquet", ".png", ".safetensors")
GITATTRIBUTES = "".join(f"*{suffix} filter=lfs -text\n" for suffix in LFS_SUFFIXES).encode()
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
        self.folder = folder = folder.absolute()
        self.blobs = folder / "blobs"
        self.blobs.mkdir(parents=True, exist_ok=True)
        self.lock = threading.RLock()
        self.faults = Faults()
        self.log = RequestLog()
        self.failures: list[str] = []
        """Tracebacks of errors of this server itself; empty if all is well."""
        self.accounts = {
            TOKENS["write"]: Account("write", user, organizations, "write"),
            TOKENS["read"]: Account("read", user, organizations, "read"),
            TOKENS["stranger"]: Account("stranger", "stranger", (), "write"),
        }
        self.repositories: dict[tuple[str, str], Repository] = {}
        if (file := folder / "state.json").exists():
            saved = json.loads(file.read_text(encoding="utf-8"))
            for repository in map(Repository.load, saved["repositories"]):
                self.repositories[repository.kind, repository.name] = repository
        self._homes = 0
        self._listener = Listener(self, port)

    def __enter__(self) -> LocalHub:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def url(self) -> str:
        """What `HF_ENDPOINT` has to be."""
        return f"http://127.0.0.1:{self._listener.server_address[1]}"

    def stop(self) -> None:
        """Stop answering; the state stays in the folder."""
        self.faults.clear()
        self._listener.shutdown()
        self._listener.server_close()

    def wait_until_quiet(self) -> None:
        """Wait until no request is being answered, such as those of a client that was killed."""
        assert self._listener.wait_until_quiet(seconds=10.0)

    def env(self, token: str | None = "write") -> dict[str, str]:
        """Return the environment of a process that is to talk to this Hub, with empty caches.

        Args:
            token: Label of the token: `write`, `read`, `stranger`, `rejected`; None for none.
        """
        self._homes += 1
        home = self.folder / "homes" / str(self._homes)
        kept = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith(FOREIGN_SETTINGS) and name.lower() not in PROXIES
        }
        environment = kept | SETTINGS | {"HF_ENDPOINT": self.url, "HF_HOME": str(home)}
        return environment | ({} if token is None else {"HF_TOKEN": TOKENS[token]})

    def save(self) -> None:
        """Write what there is, so that it is there wholly or not at all."""
        repositories = [asdict(repository) for repository in self.repositories.values()]
        saved = {"repositories": repositories}
        unfinished = self.folder / "state.json.unfinished"
        unfinished.write_text(json.dumps(saved), encoding="utf-8")
        unfinished.replace(self.folder / "state.json")

    def create_repo(self, name: str, private: bool = False, kind: str = "dataset") -> None:
        """Make a repository with its first commit."""
        with self.lock:
            repository = self.repositories[kind, name] = Repository(kind, name, private)
            tree = {".gitattributes": self.regular_entry(GITATTRIBUTES)}
            repository.commit(MAIN, tree, "initial commit")
            self.save()

    def regular_entry(self, content: bytes) -> Entry:
        """Return the entry of a file that is in git itself, and store its content."""
        sha256 = hashlib.sha256(content).hexdigest()
        self.blob(sha256).write_bytes(content)
        return Entry(git_oid(content), sha256, len(content))

    def lfs_entry(self, sha256: str) -> Entry:
        """Return the entry of a stored content of which git holds a pointer."""
        size = self.blob(sha256).stat().st_size
        version = "https://git-lfs.github.com/spec/v1"
        pointer = f"version {version}\noid sha256:{sha256}\nsize {size}\n".encode()
        return Entry(git_oid(pointer), sha256, size, is_lfs=True)

    def receive(self, sha256: str, chunks: Iterable[bytes]) -> bool:
        """Store a content that comes in pieces; return whether it has the hash announced."""
        found, unfinished = hashlib.sha256(), self.blobs / f"{uuid4().hex}.part"
        with unfinished.open("wb") as file:
            for chunk in chunks:
                found.update(chunk)
                file.write(chunk)
        if found.hexdigest() == sha256:
            unfinished.replace(self.blob(sha256))
            return True
        unfinished.unlink()
        return False

    def has(self, name: str, kind: str = "dataset") -> bool:
        """Return whether there is a repository."""
        return (kind, name) in self.repositories

    def is_private(self, name: str) -> bool:
        """Return whether only its owner sees a dataset."""
        return self.repositories["dataset", name].private

    def commit(
        self, name: str, path: str = "NEWS.md", content: bytes = b"news", kind: str = "dataset"
    ) -> Commit:
        """Return a commit to `main` by another user."""
        with self.lock:
            repository = self.repositories[kind, name]
            tree = {**repository.find("main").tree, path: self.regular_entry(content)}
            return repository.commit(MAIN, tree, f"Change {path}")

    def tag(self, name: str, tag: str, kind: str = "dataset") -> None:
        """Let a tag point at the head of `main`."""
        refs = self.repositories[kind, name].refs
        refs[f"refs/tags/{tag}"] = refs[MAIN]

    def refs(self, name: str, kind: str = "dataset") -> dict[str, str]:
        """Return the commit of every full ref, such as `refs/tags/1.0.0`."""
        return dict(self.repositories[kind, name].refs)

    def tree(self, name: str, revision: str = "main", kind: str = "dataset") -> Mapping[str, Entry]:
        """Return the files of a revision by their paths."""
        return self.repositories[kind, name].find(revision).tree

    def history(self, name: str, kind: str = "dataset") -> list[Commit]:
        """Return the commits up to the head of `main`, newest first."""
        repository = self.repositories[kind, name]
        return list(repository.history(repository.find("main")))

    def blob(self, sha256: str) -> Path:
        """Return the file in which a content is stored."""
        return self.blobs / sha256

    def content(self, name: str, path: str, revision: str = "main", kind: str = "dataset") -> bytes:
        """Return the content of a file."""
        return self.blob(self.tree(name, revision, kind)[path].sha256).read_bytes()
