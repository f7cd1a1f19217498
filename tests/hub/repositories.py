"""Repositories as git keeps them: commits with a parent, trees of files, and refs, all on disk."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path

MAIN = "refs/heads/main"
SHORTEST_COMMIT = 7


class UnknownRevisionError(ValueError):
    """A repository has no such branch, tag or commit."""


@dataclass(frozen=True)
class Entry:
    """A file of a tree."""

    oid: str
    """SHA-1 of git's blob: the content or, for LFS, the pointer to it."""
    sha256: str
    """SHA-256 of the content, under which it is stored."""
    size: int
    pointer_size: int | None = None
    """Size of the LFS pointer; None for a file that is in git itself."""
    xet_hash: str | None = None

    @property
    def is_lfs(self) -> bool:
        """Whether git holds a pointer only."""
        return self.pointer_size is not None


Tree = Mapping[str, Entry]


@dataclass(frozen=True)
class Commit:
    """A commit, with the whole of its tree."""

    oid: str
    parent: str | None
    tree: Tree
    title: str
    message: str
    author: str
    date: str


def git_oid(content: bytes) -> str:
    """Return the SHA-1 that git gives a blob."""
    return hashlib.sha1(b"blob %d\0%b" % (len(content), content)).hexdigest()


def regular_entry(content: bytes) -> Entry:
    """Return the entry of a file that is in git itself."""
    return Entry(git_oid(content), hashlib.sha256(content).hexdigest(), len(content))


def lfs_entry(sha256: str, size: int, xet_hash: str | None = None) -> Entry:
    """Return the entry of a file of which git holds the pointer."""
    version = "https://git-lfs.github.com/spec/v1"
    pointer = f"version {version}\noid sha256:{sha256}\nsize {size}\n".encode()
    return Entry(git_oid(pointer), sha256, size, len(pointer), xet_hash)


def now() -> str:
    """Return the time as the Hub writes it."""
    return datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%S.000Z")


def write_whole(path: Path, text: str) -> None:
    """Write a file so that it is there wholly or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.name + ".unfinished")
    unfinished.write_text(text, encoding="utf-8")
    unfinished.replace(path)


class Repository:
    """A repository in a folder: a file for each commit, and one for the refs.

    A commit is written before the ref that makes it part of the repository, so that a server
    killed in between has only lost it.
    """

    def __init__(self, folder: Path, kind: str, name: str, private: bool = False) -> None:
        self.folder = folder
        self.kind = kind
        self.name = name
        self.private = private
        self.created = now()
        self.refs: dict[str, str] = {}
        self._commits: dict[str, Commit] = {}

    @classmethod
    def load(cls, folder: Path) -> Repository:
        """Return the repository that was saved in a folder."""
        saved = json.loads((folder / "repository.json").read_text(encoding="utf-8"))
        repository = cls(folder, saved["kind"], saved["name"], saved["private"])
        repository.created = saved["created"]
        repository.refs = saved["refs"]
        return repository

    def save(self) -> None:
        """Write what can change: the refs, and who may see the repository."""
        attributes = ("kind", "name", "private", "created", "refs")
        state = {name: getattr(self, name) for name in attributes}
        write_whole(self.folder / "repository.json", json.dumps(state, indent=1))

    def commit(self, ref: str, tree: Tree, title: str, message: str, author: str) -> Commit:
        """Return a new commit on top of what the ref points at, which now points at it."""
        content = {
            "parent": self.refs.get(ref),
            "tree": {path: asdict(tree[path]) for path in sorted(tree)},
            "title": title,
            "message": message,
            "author": author,
            "date": now(),
        }
        text = json.dumps(content, indent=1)
        commit = self._parse_commit(git_oid(text.encode()), text)
        write_whole(self.folder / "commits" / f"{commit.oid}.json", text)
        self.point(ref, commit.oid)
        return commit

    def point(self, ref: str, oid: str | None) -> None:
        """Let a ref point at a commit; None removes it."""
        if oid is None:
            del self.refs[ref]
        else:
            self.refs[ref] = oid
        self.save()

    def find(self, revision: str) -> Commit:
        """Return the commit that a branch, a tag, a full ref or a commit's name means.

        Raises:
            UnknownRevisionError: if there is none, or more than one.
        """
        for ref in (revision, f"refs/heads/{revision}", f"refs/tags/{revision}"):
            if ref in self.refs:
                return self.read_commit(self.refs[ref])
        if len(revision) >= SHORTEST_COMMIT and set(revision) <= set("0123456789abcdef"):
            found = list((self.folder / "commits").glob(f"{revision}*.json"))
            if len(found) == 1:
                return self.read_commit(found[0].stem)
        raise UnknownRevisionError(f"Invalid rev id: {revision}")

    def read_commit(self, oid: str) -> Commit:
        """Return the commit with that name."""
        if oid not in self._commits:
            path = self.folder / "commits" / f"{oid}.json"
            self._commits[oid] = self._parse_commit(oid, path.read_text(encoding="utf-8"))
        return self._commits[oid]

    def history(self, commit: Commit) -> Iterator[Commit]:
        """Yield a commit and all before it, newest first."""
        yield commit
        while commit.parent is not None:
            commit = self.read_commit(commit.parent)
            yield commit

    def last_change(self, commit: Commit, path: str) -> Commit:
        """Return the newest commit, from that one back, which changed a file."""
        entry = commit.tree.get(path)
        for older in self.history(commit):
            if older.tree.get(path) != entry:
                break
            commit = older
        return commit

    def _parse_commit(self, oid: str, text: str) -> Commit:
        saved = json.loads(text)
        tree = {path: Entry(**entry) for path, entry in saved.pop("tree").items()}
        return Commit(oid=oid, tree=tree, **saved)
