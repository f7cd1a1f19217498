"""A repository on the Hugging Face Hub: its files, its tags, and who may change it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from huggingface_hub import HfApi, RepoFile, constants, get_token
from huggingface_hub.errors import EntryNotFoundError, HfHubHTTPError, RevisionNotFoundError

from labyrinth_core.data.errors import DatasetError, one_line
from pipeline.machinery.console import say
from pipeline.machinery.own_files import HASHES, OwnFiles
from pipeline.release.faults import (
    FAULTS,
    NO_TOKEN,
    PublishError,
    allowed,
    reasons,
    repeated,
    status_of,
)
from pipeline.release.plan import SPACE, Kind

VERSION = re.compile(r"\d+\.\d+\.\d+", re.ASCII)
"""What a tag of a release looks like."""

SOURCES = "source_datasets"
"""The key of a card's front matter under which an export names its dataset."""


@dataclass(frozen=True)
class Remote:
    """A repository on the Hub, there or not."""

    api: HfApi
    repo_id: str
    kind: Kind

    def _call(self, method: str, **options: Any) -> Any:
        """Return what a method of the client, which may be called twice, says of the repository."""
        call = getattr(self.api, method)
        return repeated(lambda: call(self.repo_id, repo_type=self.kind.repo_type, **options))

    def check_access(self, *, create_pr: bool) -> bool:
        """Return whether the repository is there.

        A token for one repository may not ask whose it is: the Hub's answers about that repository
        then say whether it is valid.

        Raises:
            PublishError: There is no token, or it cannot be used for this.
            HfHubHTTPError: The Hub refuses.
        """
        if not get_token():
            raise PublishError(
                "there is no Hub token: set HF_TOKEN, or run `hf auth login`, "
                f"which leaves one in {constants.HF_TOKEN_PATH}"
            )
        user = allowed(self.api.whoami)
        if self._call("repo_exists"):
            # Anybody who sees a repository may propose a change of it.
            self._call("auth_check", write=not create_pr)
            if not user:
                say("left out: asking the Hub whose token this is, which this token may not.")
            return True
        if not user:
            raise PublishError(
                f"{self.repo_id} does not exist, or the Hub rejects this token; a token for one "
                "repository cannot make it: make it on the Hub, empty, then publish again"
            )
        own = [user["name"], *(organization["name"] for organization in user.get("orgs", []))]
        if self.repo_id.partition("/")[0] not in own:
            raise PublishError(
                f"{self.repo_id} does not exist, or this token may not see it; it may make "
                f"{self.kind.repo_type}s of {', '.join(own)}"
            )
        if user.get("auth", {}).get("accessToken", {}).get("role") == "read":
            raise PublishError(reasons(self.repo_id)[403])
        return False

    def create(self, *, private: bool) -> None:
        """Make the repository, unless it is there; a Space is static.

        Raises:
            PublishError: The token may not.
        """
        own = {"space_sdk": "static"} if self.kind is SPACE else {}
        make = partial(self._call, "create_repo", private=private, exist_ok=True, **own)
        if allowed(make) is None:
            raise PublishError(
                f"the token may not make {self.repo_id}: make it on the Hub, empty, then publish "
                "again, or use a token that may write"
            )

    def create_branch(self, branch: str) -> None:
        """Make a branch at the head of `main`, unless it is there."""
        self._call("create_branch", branch=branch, exist_ok=True)

    def head(self, branch: str) -> str:
        """Return the commit at the head of a branch, or of `main` if there is no such branch."""
        try:
            return self.commit(branch)
        except RevisionNotFoundError:
            return self.commit("main")

    def commit(self, revision: str) -> str:
        """Return the commit that a branch, a tag or a commit means."""
        return str(self._call("repo_info", revision=revision).sha)

    def tree(self, commit: str) -> dict[str, str]:
        """Return path -> SHA-256 of each large file of a commit, git's hash of each other."""
        entries = self.api.list_repo_tree(
            self.repo_id, repo_type=self.kind.repo_type, revision=commit, recursive=True
        )
        return {
            entry.path: entry.lfs.sha256 if entry.lfs else entry.blob_id
            for entry in entries
            if isinstance(entry, RepoFile)
        }

    def released(self, commit: str, files: Mapping[str, str]) -> set[str]:
        """Return which files of a commit are as a release has left them, by its SHA256SUMS.

        Args:
            commit: The commit.
            files: Some of its files, as from `tree`.
        """
        try:
            own = OwnFiles.read(self.download(HASHES, commit).parent, self.kind.listed)
        except (EntryNotFoundError, DatasetError):  # There is none, or somebody else's.
            return set()
        listed = {name for name, _ in own.hashes}
        for path in files:
            if path in listed and len(files[path]) != 64:  # Git has another hash of it.
                self.download(path, commit)
        found = {path for path in files if (path, files[path]) in own.hashes or own.has(path)}
        return found | ({HASHES} & files.keys())

    def is_new(self, commit: str) -> bool:
        """Return whether a commit holds nothing but what the Hub puts into a new repository."""
        commits = self._call("list_repo_commits", revision=commit)
        return [each.title for each in commits] == ["initial commit"]

    def proposals(self, title: str) -> dict[str, str]:
        """Return ref -> address of each open pull request with a title."""
        call, kind = self.api.get_repo_discussions, self.kind.repo_type
        found = repeated(lambda: [*call(self.repo_id, discussion_status="open", repo_type=kind)])
        mine = (each for each in found if each.is_pull_request and each.title == title)
        return {str(each.git_reference): each.url for each in mine}

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
        """Let a tag point to a commit.

        Raises:
            PublishError: It points to another.
        """
        if tag not in self.tags():
            try:
                self._call("create_tag", tag=tag, revision=commit)
            except HfHubHTTPError as error:
                # It is there: by a call whose answer was lost, or by somebody else's.
                if status_of(error) != 409:
                    raise
        tagged = self.tags().get(tag)
        if tagged != commit:
            raise PublishError(
                f"the tag {tag} of {self.repo_id} points to {str(tagged)[:12]}, not to the release "
                f"at {commit[:12]}: choose another publish.version"
            )

    def move_tag(self, tag: str, commit: str) -> None:
        """Let a tag that follows the newest release point to a commit.

        The Hub moves no tag: for a moment there is none, as after LeRobot's own `push_to_hub`.
        """
        if self.tags().get(tag, commit) != commit:
            with suppress(RevisionNotFoundError):  # Gone, by a call whose answer was lost.
                self._call("delete_tag", tag=tag)
        self.tag(tag, commit)

    def exports(self) -> list[str]:
        """Return the owner's public datasets whose cards name this one as their source."""
        owner, call = self.repo_id.partition("/")[0], self.api.list_datasets
        found = allowed(lambda: [*call(author=owner, expand=["cardData", "private"])])
        if found is None:
            say("left out: links to exports, which this token may not look for.")
            return []
        cards = {each.id: each.card_data for each in found if each.card_data and not each.private}
        return sorted(
            id_ for id_, card in cards.items() if self.repo_id in [*(card.get(SOURCES) or ())]
        )

    def join(self, collection: str, *, private: bool) -> None:
        """Put the repository into the collection with a title, which is made if need be.

        A token that may not do that leaves a line instead, since the release is done.
        """
        owner = self.repo_id.partition("/")[0]
        make, add = self.api.create_collection, self.api.add_collection_item
        made = allowed(lambda: make(collection, namespace=owner, private=private, exists_ok=True))
        if made and allowed(
            lambda: add(made.slug, self.repo_id, self.kind.repo_type, exists_ok=True)
        ):
            say(f"{self.repo_id} is in the collection {collection}.")
        else:
            say(
                f"left out: joining the collection {collection}, which this token may not; add "
                f"{self.repo_id} to it on the Hub."
            )


@dataclass(frozen=True)
class UnseenRemote(Remote):
    """A repository that a dry run cannot look at, and takes for one that does not exist yet."""

    def check_access(self, *, create_pr: bool) -> bool:  # noqa: ARG002
        return False

    def versions(self) -> dict[str, str]:
        return {}

    def exports(self) -> list[str]:
        return []


def why_unseen(api: HfApi) -> str:
    """Return why the Hub cannot be looked at, such as for want of a token; empty if it can be."""
    try:
        if not get_token():
            return "there is no token"
        allowed(api.whoami)
    except (*FAULTS, ConnectionError, NO_TOKEN) as error:
        if status_of(error) is None:
            return f"{constants.ENDPOINT} does not answer: {one_line(error)}"
    return ""
