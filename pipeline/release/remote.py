"""A repository on the Hugging Face Hub: its files, its tags, and what a release changes in it.

Repositories are of five kinds: datasets, exports in two formats, models (policies), environments.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from huggingface_hub import HfApi, RepoFile, constants, get_token
from huggingface_hub.errors import (
    EntryNotFoundError,
    HfHubHTTPError,
    LocalEntryNotFoundError,
    RevisionNotFoundError,
)
from huggingface_hub.utils.sha import git_hash

from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.storage import file_sha256
from pipeline.config.export import CODEBASE_VERSION
from pipeline.machinery.artifact import HASHES, Sums
from pipeline.machinery.console import say
from pipeline.release.faults import FAULTS, NO_TOKEN, PublishError, repeated, status_of

REFUSED = (401, 403)
"""The HTTP statuses if a token may not create a repository; 401 if it is for another one only."""

VERSION = re.compile(r"\d+\.\d+\.\d+", re.ASCII)
"""The form of a release's tag."""


def number(version: str) -> list[int]:
    """Return the numbers of a version, the key to sort versions by."""
    return [*map(int, version.split("."))]


@dataclass(frozen=True)
class Kind:
    """A kind of repository, and which files a release has in it."""

    repo_type: Literal["dataset", "model"]
    """The Hub's type of the repository."""
    data: str
    """A regular expression for the paths of data, not of the files that describe it.

    Some path in every SHA256SUMS of this kind matches it, and none in one of another kind.
    """
    library: str = ""
    """The library that an export is for."""
    newest_tag: str | None = None
    """A tag, beside the one of each version, that moves to the newest release on `main`."""

    def is_data(self, path: str) -> bool:
        """Return whether a path is data, and not part of the card."""
        return re.fullmatch(self.data, path, re.ASCII) is not None


DATASET = Kind(
    "dataset",
    data=r"\d+x\d+(-\w+){0,2}/(manifest\.json|labyrinths\.parquet|\w+-\d{5,}-of-\d{5,}\.parquet)",
)
LEROBOT = Kind("dataset", r"(data|meta)/.+", "LeRobot", newest_tag=CODEBASE_VERSION)
MINARI = Kind("dataset", r"[^/]+/[^/]+/data/.+", "Minari")
MODEL = Kind("model", r"config\.json|model\.safetensors")
ENVIRONMENT = Kind("model", r"env\.py")


@dataclass(frozen=True)
class Plan:
    """The changes that a release would make."""

    files: Mapping[str, Path]
    """All files of the release, by their path on the Hub."""
    add: list[str]
    keep: list[str]
    delete: list[str]
    others: list[str]
    """Paths in `add` where the Hub holds a file that no release wrote."""

    @property
    def bytes(self) -> int:
        """The number of bytes to send."""
        return sum(self.files[path].stat().st_size for path in self.add)

    @property
    def changed(self) -> list[str]:
        """The paths to add or delete."""
        return [*self.add, *self.delete]


@dataclass(frozen=True)
class Remote:
    """A repository on the Hub, which need not exist yet."""

    api: HfApi
    repo_id: str
    kind: Kind
    is_unseen: bool = False
    """Whether a dry run cannot query the Hub, and treats the repository as not existing yet."""

    def _call(self, method: str, **options: Any) -> Any:
        """Return the result of an idempotent method of the client for the repository."""
        call = getattr(self.api, method)
        return repeated(lambda: call(self.repo_id, repo_type=self.kind.repo_type, **options))

    def exists(self) -> bool:
        """Return whether the repository exists.

        Raises:
            PublishError: There is no token.
            HfHubHTTPError: The token may not write to the repository.
        """
        if self.is_unseen:
            return False
        if not get_token():
            raise PublishError(
                "there is no Hub token: set HF_TOKEN, or run `hf auth login`, "
                f"which leaves one in {constants.HF_TOKEN_PATH}"
            )
        there = bool(self._call("repo_exists"))
        if there:
            self._call("auth_check", write=True)
        return there

    def create(self, *, private: bool) -> None:
        """Create the repository, unless it exists.

        Raises:
            PublishError: The token may not create it.
        """
        if self.exists():
            return
        try:
            self._call("create_repo", private=private, exist_ok=True)
        except HfHubHTTPError as error:
            if status_of(error) not in REFUSED:
                raise
            raise PublishError(
                f"{self.repo_id} does not exist, or this token may not see it, and the token may "
                "not create it: use another token, or create it empty on the Hub, and publish again"
            ) from error

    def commit(self, revision: str) -> str:
        """Return the commit hash that a branch, a tag or a commit refers to."""
        return str(self._call("repo_info", revision=revision).sha)

    def tree(self, commit: str) -> dict[str, str]:
        """Return path -> hash for the files of a commit: SHA-256 if large, else Git's blob hash."""
        entries = self.api.list_repo_tree(
            self.repo_id, repo_type=self.kind.repo_type, revision=commit, recursive=True
        )
        return {
            entry.path: entry.lfs.sha256 if entry.lfs else entry.blob_id
            for entry in entries
            if isinstance(entry, RepoFile)
        }

    def plan(self, files: Mapping[str, Path], commit: str) -> Plan:
        """Return what to change so that the Hub holds these files.

        Args:
            files: The local files by their path on the Hub.
            commit: The commit to change; empty if none exists.
        """
        tree = self.tree(commit) if commit else {}
        add = differing(files, tree)
        keep = [path for path in files if path not in add]
        rest = {path: tree[path] for path in sorted(tree.keys() - set(keep))}
        ours = self._released(commit, rest) if rest else set()
        return Plan(
            files=files,
            add=add,
            keep=keep,
            delete=sorted(ours - files.keys()),
            others=[path for path in add if path in tree and path not in ours],
        )

    def _released(self, commit: str, files: Mapping[str, str]) -> set[str]:
        """Return the files of a commit that a release wrote, unchanged since by its SHA256SUMS.

        Others are neither replaced nor deleted.

        Args:
            commit: The commit.
            files: Some of its files, as from `tree`.
        """
        try:
            own = Sums.read(self.download(HASHES, commit).parent)
        except (EntryNotFoundError, DatasetError):  # It is missing or not ours.
            return set()
        listed = {name for name, _ in own.hashes}
        if not any(map(self.kind.is_data, listed)):
            return set()  # It is of a repository of another kind.
        for path in files:
            if path in listed and len(files[path]) != 64:  # Its hash is Git's.
                self.download(path, commit)
        found = {path for path in files if (path, files[path]) in own.hashes or own.has(path)}
        return found | ({HASHES} & files.keys())

    def is_new(self, commit: str) -> bool:
        """Return whether a commit holds only what the Hub puts into a new repository."""
        commits = self._call("list_repo_commits", revision=commit)
        return [each.title for each in commits] == ["initial commit"]

    def tags(self) -> dict[str, str]:
        """Return the commit that each tag points to."""
        tags = self._call("list_repo_refs").tags
        return {str(each.name): str(each.target_commit) for each in tags}

    def versions(self) -> dict[str, str]:
        """Return the commit of each tag that is a version, such as 1.0.0."""
        return {tag: commit for tag, commit in self.tags().items() if VERSION.fullmatch(tag)}

    def download(self, path: str, commit: str) -> Path:
        """Return a file of a commit, in the Hub's cache.

        Raises:
            EntryNotFoundError: The commit lacks the file; not raised if the Hub cannot be asked.
        """
        get = self.api.hf_hub_download

        def downloaded() -> str:
            try:
                return get(self.repo_id, path, repo_type=self.kind.repo_type, revision=commit)
            except LocalEntryNotFoundError as error:  # The Hub gives an error, or no answer.
                raise error.__cause__ or error from None

        return Path(repeated(downloaded))

    def tag(self, tag: str, commit: str) -> None:
        """Create a tag at a commit, unless it is there already.

        Raises:
            PublishError: The tag points to another commit.
        """
        if tag not in self.tags():
            try:
                self._call("create_tag", tag=tag, revision=commit)
            except HfHubHTTPError as error:
                # It exists: our first answer was lost, or another user created it.
                if status_of(error) != 409:
                    raise
        tagged = self.tags().get(tag)
        if tagged != commit:
            raise PublishError(
                f"the tag {tag} of {self.repo_id} points to {str(tagged)[:12]}, not to the release "
                f"at {commit[:12]}: choose another publish.version"
            )

    def move_tag(self, tag: str, commit: str) -> None:
        """Move the tag of the newest release to a commit.

        The Hub cannot move a tag: for a moment it is missing, as in LeRobot's own `push_to_hub`.
        """
        if self.tags().get(tag, commit) != commit:
            with suppress(RevisionNotFoundError):  # Deleted by a call whose answer was lost.
                self._call("delete_tag", tag=tag)
        self.tag(tag, commit)


def differing(files: Mapping[str, Path], tree: Mapping[str, str]) -> list[str]:
    """Return the paths of local files that a tree, as from `Remote.tree`, does not hold."""
    return [path for path in files if path not in tree or not _is_same(files[path], tree[path])]


def _is_same(local: Path, digest: str) -> bool:
    """Return whether a file has this SHA-256 (64 digits) or this hash of a Git blob."""
    return digest == (file_sha256(local) if len(digest) == 64 else git_hash(local.read_bytes()))


def is_unseen(api: HfApi, repo_id: str) -> bool:
    """Return whether a dry run cannot query the Hub, such as without a token, and print why."""
    reason = "" if get_token() else "there is no token"
    try:
        if not reason:
            api.repo_exists(repo_id)
    except (*FAULTS, ConnectionError, NO_TOKEN) as error:
        if status_of(error) is None:
            reason = f"{constants.ENDPOINT} does not answer: {one_line(error)}"
    if reason:
        say(
            f"cannot query the Hub ({reason}), so the plan is for a new repository; "
            "scripts/local_hub starts a Hub on this machine, for rehearsals."
        )
    return bool(reason)
