"""A repository on the Hugging Face Hub: its files, its tags, and who may change it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from huggingface_hub import HfApi, RepoFile, constants, get_token
from huggingface_hub.errors import EntryNotFoundError, HfHubHTTPError, RevisionNotFoundError

from labyrinth_core.data.errors import DatasetError, one_line
from pipeline.machinery.artifact import HASHES, Sums
from pipeline.release.faults import FAULTS, NO_TOKEN, PublishError, repeated, status_of
from pipeline.release.plan import Kind

REFUSED = (401, 403)
"""The HTTP statuses if a token may not create a repository; 401 if it is for another one only."""

VERSION = re.compile(r"\d+\.\d+\.\d+", re.ASCII)
"""The form of a release's tag."""


def number(version: str) -> list[int]:
    """Return the numbers of a version, the key to sort versions by."""
    return [*map(int, version.split("."))]


@dataclass(frozen=True)
class Remote:
    """A repository on the Hub, which need not exist yet."""

    api: HfApi
    repo_id: str
    kind: Kind

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
        """Create the repository.

        Raises:
            PublishError: The token may not create it.
        """
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

    def released(self, commit: str, files: Mapping[str, str]) -> set[str]:
        """Return the files of a commit that a release wrote, unchanged since by its SHA256SUMS.

        Args:
            commit: The commit.
            files: Some of its files, as from `tree`.
        """
        try:
            own = Sums.read(self.download(HASHES, commit).parent)
        except (EntryNotFoundError, DatasetError):  # It is missing or not ours.
            return set()
        listed = {name for name, _ in own.hashes}
        if not any(re.fullmatch(self.kind.listed, name) for name in listed):
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
        """Return a file of a commit, in the Hub's cache."""
        return Path(self._call("hf_hub_download", filename=path, revision=commit))

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


class UnseenRemote(Remote):
    """A repository that a dry run cannot query, and treats as not existing yet."""

    def exists(self) -> bool:
        """Return False."""
        return False


def why_unseen(api: HfApi, repo_id: str) -> str:
    """Return why a dry run cannot query the Hub, such as a missing token; empty if it can.

    Args:
        api: The Hub's client.
        repo_id: A repository to ask for.
    """
    if not get_token():
        return "there is no token"
    try:
        api.repo_exists(repo_id)
    except (*FAULTS, ConnectionError, NO_TOKEN) as error:
        if status_of(error) is None:
            return f"{constants.ENDPOINT} does not answer: {one_line(error)}"
    return ""
