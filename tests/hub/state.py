"""What the Hub on loopback keeps: accounts, repositories as git has them, and a log of requests."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

MAIN = "refs/heads/main"
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
        if revision in self.commits:
            return self.commits[revision]
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


@dataclass(frozen=True)
class Exchange:
    """A request and its answer."""

    method: str
    path: str
    """Unquoted, without the query."""
    status: int
    """0 if the connection was dropped, by either side, before an answer."""
    token: str
    """Label of the token; `none` without one, `rejected` if unknown."""
    sent: int = 0
    """The bytes of the answer's body."""

    def __str__(self) -> str:
        return f"{self.status or '---'} {self.method:6} {self.path} ({self.token})"


class RequestLog:
    """All exchanges since the Hub was started."""

    def __init__(self) -> None:
        self.on_exchange: Callable[[Exchange], None] | None = None
        self._exchanges: list[Exchange] = []

    def __len__(self) -> int:
        """Return the number of exchanges, to be given as `since` later."""
        return len(self._exchanges)

    def add(self, exchange: Exchange) -> None:
        """Keep an exchange."""
        self._exchanges.append(exchange)
        if self.on_exchange is not None:
            self.on_exchange(exchange)

    def find(
        self, method: str | None = None, path: str = "", status: int | None = None, since: int = 0
    ) -> list[Exchange]:
        """Return the exchanges with that method and status whose path matches a pattern."""
        return [
            exchange
            for exchange in self._exchanges[since:]
            if method in (None, exchange.method)
            and status in (None, exchange.status)
            and re.search(path, exchange.path)
        ]

    def uploaded(self, since: int = 0) -> list[str]:
        """Return the SHA-256 of each content that was sent, as often as it was."""
        return [each.path.rpartition("/")[2] for each in self.find("PUT", "^/lfs/", 200, since)]
