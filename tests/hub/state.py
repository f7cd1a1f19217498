"""All that a Hub keeps: repositories, contents, collections, the log; and how to find it."""

from __future__ import annotations

import hashlib
import hmac
import json
import shutil
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

from hub.accounts import Account
from hub.blobs import Blobs
from hub.faults import Faults
from hub.repositories import MAIN, Commit, Entry, Repository, regular_entry, write_whole
from hub.request_log import RequestLog

MODES = ("xet", "lfs-basic", "lfs-multipart")
GITATTRIBUTES = b"".join(
    b"*.%b filter=lfs diff=lfs merge=lfs -text\n" % suffix
    for suffix in (b"gz", b"jpg", b"npz", b"parquet", b"png", b"safetensors", b"tar", b"zip")
)
"""What the Hub puts into every new repository, in short."""
TEMPLATE = {
    "README.md": b"---\ntitle: New\nsdk: static\n---\n",
    "index.html": b"<h1>Welcome to your static Space!</h1>\n",
    "style.css": b"body { padding: 2rem; }\n",
}
"""What the Hub puts into a new static Space, in short."""
SOMEBODY_ELSE = "somebody-else"


@dataclass
class HubState:
    """The state of a Hub in a folder, and how it is set to behave."""

    folder: Path
    mode: str
    """How contents are uploaded: `xet`, `lfs-basic` or `lfs-multipart`."""
    accounts: tuple[Account, ...]
    part_size: int
    """Bytes of a part in `lfs-multipart`."""
    faults: Faults = field(default_factory=Faults)
    url: str = ""
    """Where the Hub listens."""
    cdn_url: str = ""
    """Where contents are uploaded to and downloaded from: another origin, as on the real Hub."""

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise ValueError(f"mode is {self.mode!r}; allowed are {', '.join(MODES)}")
        self.folder.mkdir(parents=True, exist_ok=True)
        self.lock = threading.RLock()
        self.log = RequestLog(self.folder / "log.ndjson")
        self.blobs = Blobs(self.folder)
        saved = (self.folder / "repositories").glob("*/*/*/repository.json")
        loaded = [Repository.load(path.parent) for path in saved]
        self._repositories = {(each.kind, each.name): each for each in loaded}
        path = self.folder / "collections.json"
        self.collections: dict[str, dict[str, Any]] = {}
        if path.exists():
            self.collections = json.loads(path.read_text(encoding="utf-8"))

    def account(self, token: str | None) -> Account | None:
        """Return whose token it is, None if nobody's."""
        return next((account for account in self.accounts if account.token == token), None)

    def repository(self, kind: str, name: str) -> Repository | None:
        """Return a repository, None if there is none."""
        return self._repositories.get((kind, name))

    def repositories(self) -> list[Repository]:
        """Return all repositories."""
        return list(self._repositories.values())

    def create_repository(self, kind: str, name: str, private: bool, author: str) -> Repository:
        """Return a new repository with its first commit."""
        folder = self.folder / "repositories" / kind / name
        repository = Repository(folder, kind, name, private)
        self.blobs.add(GITATTRIBUTES)
        tree = {".gitattributes": regular_entry(GITATTRIBUTES)}
        for path, content in TEMPLATE.items() if kind == "space" else ():
            self.blobs.add(content)
            tree[path] = regular_entry(content)
        repository.commit(MAIN, tree, "initial commit", "", author)
        self._repositories[kind, name] = repository
        return repository

    def delete_repository(self, repository: Repository) -> None:
        """Remove a repository; contents stay."""
        del self._repositories[repository.kind, repository.name]
        shutil.rmtree(repository.folder)

    def commit_as_somebody_else(
        self, repository: Repository, path: str = "NEWS.md", content: bytes | None = None
    ) -> Commit:
        """Return a new commit on `main` that no client asked for."""
        if content is None:
            content = f"after {repository.refs[MAIN]}\n".encode()
        self.blobs.add(content)
        tree = {**repository.find("main").tree, path: regular_entry(content)}
        return repository.commit(MAIN, tree, f"Change {path}", "", SOMEBODY_ELSE)

    def save_collections(self) -> None:
        """Write the collections."""
        write_whole(self.folder / "collections.json", json.dumps(self.collections, indent=1))

    def content(self, entry: Entry) -> bytes:
        """Return the content of a file."""
        return self.blobs.read(entry.sha256)

    def sign(self, method: str, path: str) -> str:
        """Return a URL of the CDN that works without a token, for that method only."""
        return f"{self.cdn_url}{quote(path)}?X-Signature={self._signature(method, path)}"

    def is_signed(self, method: str, path: str, signature: str) -> bool:
        """Return whether a URL was made by `sign`; who may GET may HEAD."""
        expected = self._signature("GET" if method == "HEAD" else method, path)
        return hmac.compare_digest(expected, signature)

    def _signature(self, method: str, path: str) -> str:
        secret = hashlib.sha256(str(self.folder).encode()).digest()
        return hmac.new(secret, f"{method} {path}".encode(), "sha256").hexdigest()
