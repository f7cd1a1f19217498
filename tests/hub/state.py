"""What the Hub on loopback keeps: accounts, repositories as git has them, contents, collections."""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from uuid import uuid4

from hub.faults import Faults
from hub.request_log import RequestLog

MAIN = "refs/heads/main"
SHORTEST_COMMIT = 7
LFS_SUFFIXES = (".parquet", ".png", ".safetensors")
GITATTRIBUTES = "".join(f"*{suffix} filter=lfs -text\n" for suffix in LFS_SUFFIXES).encode()
TEMPLATE = {"style.css": b"body { padding: 2rem; }\n"}
"""What the Hub puts into a new static Space, in short."""
TOKENS = {
    "write": "hf_loopbackTokenThatMayWrite",
    "read": "hf_loopbackTokenThatMayRead",
    "stranger": "hf_loopbackTokenOfAnotherUser",
    "rejected": "hf_loopbackTokenThatTheHubRejects",
}
"""All tokens by their labels; the Hub does not know the last one."""
ID_TOKEN = "loopbackIdTokenOfAJob"
"""What a job that is a trusted publisher exchanges for a token for one repository."""


@dataclass(frozen=True)
class Account:
    """What a token stands for: a user, and what the token lets them do."""

    label: str
    user: str
    organizations: tuple[str, ...]
    role: str
    """`write` or `read`."""
    only: str = ""
    """The one repository that the token is for, if it is for one, of nobody."""

    def owns(self, repository: str) -> bool:
        """Return whether a repository is the user's or that of one of their organizations."""
        if self.only:
            return repository == self.only
        return repository.split("/")[0] in (self.user, *self.organizations)


@dataclass(frozen=True)
class Entry:
    """A file of a tree."""

    oid: str
    """SHA-1 of git's blob: the content or, for LFS, the pointer to it."""
    sha256: str
    """SHA-256 of the content, under which it is stored."""
    size: int
    is_lfs: bool = False


@dataclass(frozen=True)
class Commit:
    """A commit, with the whole of its tree."""

    oid: str
    parent: str | None
    tree: Mapping[str, Entry]
    title: str


@dataclass
class Repository:
    """A repository: its commits, and the refs that point at some."""

    kind: str
    name: str
    private: bool = False
    refs: dict[str, str] = field(default_factory=dict)
    commits: dict[str, Commit] = field(default_factory=dict)

    @classmethod
    def load(cls, saved: dict[str, Any]) -> Repository:
        """Return the repository that `asdict` turned into plain values."""
        for oid, commit in saved["commits"].items():
            commit["tree"] = {path: Entry(**entry) for path, entry in commit["tree"].items()}
            saved["commits"][oid] = Commit(**commit)
        return cls(**saved)

    def commit(self, ref: str, tree: Mapping[str, Entry], title: str) -> Commit:
        """Return a new commit on top of what the ref points at, which now points at it."""
        parent = self.refs.get(ref)
        content = f"{parent} {title} {sorted(tree.items())}".encode()
        commit = Commit(git_oid(content), parent, tree, title)
        self.commits[commit.oid] = commit
        self.refs[ref] = commit.oid
        return commit

    def find(self, revision: str) -> Commit:
        """Return the commit that a branch, a tag, a full ref or a commit's name means.

        Raises:
            LookupError: There is none.
        """
        for ref in (revision, f"refs/heads/{revision}", f"refs/tags/{revision}"):
            if ref in self.refs:
                return self.commits[self.refs[ref]]
        if len(revision) >= SHORTEST_COMMIT:
            for oid, commit in self.commits.items():
                if oid.startswith(revision):
                    return commit
        raise LookupError(f"Invalid rev id: {revision}")

    def history(self, commit: Commit) -> Iterator[Commit]:
        """Yield a commit and all before it, newest first."""
        yield commit
        while commit.parent is not None:
            commit = self.commits[commit.parent]
            yield commit


def git_oid(content: bytes) -> str:
    """Return the SHA-1 that git gives a blob."""
    return hashlib.sha1(b"blob %d\0%b" % (len(content), content)).hexdigest()


class HubState:
    """The state of a Hub in a folder; a Hub that was there before goes on."""

    def __init__(self, folder: Path, user: str, organizations: tuple[str, ...]) -> None:
        self.folder = folder
        self.blobs = folder / "blobs"
        self.blobs.mkdir(parents=True, exist_ok=True)
        self.url = ""
        self.lock = threading.RLock()
        self.faults = Faults()
        self.log = RequestLog()
        self.accounts = {
            TOKENS["write"]: Account("write", user, organizations, "write"),
            TOKENS["read"]: Account("read", user, organizations, "read"),
            TOKENS["stranger"]: Account("stranger", "stranger", (), "write"),
        }
        self.repositories: dict[tuple[str, str], Repository] = {}
        self.collections: dict[str, dict[str, Any]] = {}
        if (file := folder / "state.json").exists():
            saved = json.loads(file.read_text(encoding="utf-8"))
            self.collections = saved["collections"]
            for repository in map(Repository.load, saved["repositories"]):
                self.repositories[repository.kind, repository.name] = repository

    def save(self) -> None:
        """Write what there is, so that it is there wholly or not at all."""
        repositories = [asdict(repository) for repository in self.repositories.values()]
        saved = {"repositories": repositories, "collections": self.collections}
        unfinished = self.folder / "state.json.unfinished"
        unfinished.write_text(json.dumps(saved), encoding="utf-8")
        unfinished.replace(self.folder / "state.json")

    def create(self, kind: str, name: str, private: bool) -> None:
        """Make a repository with its first commit."""
        repository = self.repositories[kind, name] = Repository(kind, name, private)
        files = {".gitattributes": GITATTRIBUTES} | (TEMPLATE if kind == "space" else {})
        tree = {path: self.regular_entry(content) for path, content in files.items()}
        repository.commit(MAIN, tree, "initial commit")
        self.save()

    def regular_entry(self, content: bytes) -> Entry:
        """Return the entry of a file that is in git itself, and store its content."""
        sha256 = hashlib.sha256(content).hexdigest()
        (self.blobs / sha256).write_bytes(content)
        return Entry(git_oid(content), sha256, len(content))

    def lfs_entry(self, sha256: str) -> Entry:
        """Return the entry of a stored content of which git holds a pointer."""
        size = (self.blobs / sha256).stat().st_size
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
            unfinished.replace(self.blobs / sha256)
            return True
        unfinished.unlink()
        return False
