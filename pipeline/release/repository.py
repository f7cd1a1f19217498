"""One release: planned by hashes, uploaded, committed at once, verified, and tagged last.

A release is what the `SHA256SUMS` of a folder lists, whatever it holds. `main` has the old release
or the new one, complete, at every moment. Running it again completes what an interruption left, or
finds that all is done. What goes up is compared with the list, and so is the commit's tree.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatch
from itertools import starmap
from pathlib import Path
from typing import Any, Literal

from huggingface_hub import (
    CommitOperationAdd,
    CommitOperationDelete,
    HfApi,
    RepoFile,
    constants,
    get_token,
)
from huggingface_hub.errors import (  # type: ignore[attr-defined]
    HfHubHTTPError,
    HTTPError,
    RevisionNotFoundError,
)
from huggingface_hub.utils.sha import git_hash

from labyrinth_core import hub
from labyrinth_core.errors import DatasetError
from pipeline.machinery import Sums, say, tracked
from pipeline.release.faults import PublishError, reasons

VERSION = re.compile(r"\d+\.\d+\.\d+", re.ASCII)
"""The form of a release's tag."""

CARD = re.compile(
    rf"{Sums.FILE}|README\.md|CHANGELOG\.md|CITATION\.cff|croissant\.json|eval\.yaml|pictures/.*"
)
"""The paths of files that describe a release; all others are data, which a tag never changes."""

MARKS = ("*/manifest.json", "meta/info.json", "namespace_metadata.json", "config.json", "env.py")
"""What a release has of one of these, its successor has too; another thing does not replace it."""

MADE_BY_THE_HUB = re.compile(r"---\nlicense: [\w.-]+\n---\s*", re.ASCII)
"""The README.md of a repository that was made on the Hub's page, with a licence."""

IN_MEMORY = 1 << 29
"""The most bytes of a file that is read once, so that what was hashed is what goes up. Of a larger
one, the client hashes what it sends."""


def number(version: str) -> list[int]:
    """Return the numbers of a version, the key to sort versions by."""
    return [*map(int, version.split("."))]


@dataclass(frozen=True)
class File:
    """A file of a release."""

    sha256: str
    """The hash that the release lists."""
    source: Path | bytes
    """The file, or its content."""

    @property
    def size(self) -> int:
        """The number of bytes."""
        return len(self.source) if isinstance(self.source, bytes) else self.source.stat().st_size

    @classmethod
    def of(cls, content: bytes) -> File:
        """Return the file with a content."""
        return cls(hashlib.sha256(content).hexdigest(), content)

    def content(self) -> bytes:
        """Return the content; raise PublishError if it has another hash than is listed."""
        content = self.source if isinstance(self.source, bytes) else self.source.read_bytes()
        self.require(hashlib.sha256(content).hexdigest())
        return content

    def require(self, digest: str) -> None:
        """Raise PublishError for another hash than the one that is listed."""
        if digest != self.sha256:
            raise PublishError(
                f"{self.source!s:.300} has changed since it was checked: its sha256 is not the "
                f"one in {Sums.FILE}; publish again"
            )

    def is_at(self, digest: str | None) -> bool:
        """Return whether a file on the Hub is this one, by its SHA-256 or Git's hash of it."""
        if digest is None or len(digest) == 64:
            return digest == self.sha256
        return digest == git_hash(self.content())


Files = Mapping[str, File]
"""The files of a release by their paths on the Hub."""


def listed(folder: Path) -> dict[str, File]:
    """Return the files that the list of a folder names, and the list itself."""
    files = {name: File(digest, folder / name) for name, digest in Sums.read(folder).hashes}
    return files | {Sums.FILE: File.of((folder / Sums.FILE).read_bytes())}


@dataclass(frozen=True)
class Plan:
    """The changes that a release would make."""

    files: Files
    add: list[str]
    keep: list[str]
    delete: list[str]
    others: list[str]
    """Paths in `add` where the Hub holds a file that no release wrote."""

    @property
    def bytes(self) -> int:
        """The number of bytes to send."""
        return sum(self.files[path].size for path in self.add)

    def missed_by(self, tree: Mapping[str, str]) -> list[str]:
        """Return the paths of a tree that are not as planned."""
        wrong = [path for path, file in self.files.items() if not file.is_at(tree.get(path))]
        return wrong + [path for path in self.delete if path in tree]


@dataclass(frozen=True)
class Repository:
    """A repository on the Hub, which need not exist yet."""

    api: HfApi
    repo_id: str
    repo_type: Literal["dataset", "model"]
    is_unseen: bool = False
    """Whether a dry run cannot query the Hub, and treats the repository as not existing yet."""

    def _call(self, method: str, **options: Any) -> Any:
        """Return the result of an idempotent method of the client for the repository."""
        call = getattr(self.api, method)
        return hub.repeated(lambda: call(self.repo_id, repo_type=self.repo_type, **options))

    def _required(self, commit: Any) -> str:
        """Return a commit that the Hub names; raise WrongAnswerError if it has another form."""
        if isinstance(commit, str) and hub.COMMIT.fullmatch(commit):
            return commit
        raise hub.WrongAnswerError(f"{self.repo_id}: the Hub calls a commit {commit!r:.60}")

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
        is_there = bool(self._call("repo_exists"))
        if is_there:
            self._call("auth_check", write=True)
        return is_there

    def create(self, *, private: bool) -> None:
        """Create the repository.

        Raises:
            PublishError: The token may not create it.
        """
        try:
            self._call("create_repo", private=private, exist_ok=True)
        except HfHubHTTPError as error:
            if hub.status_of(error) not in (401, 403):  # 401 if it is for another one only.
                raise
            raise PublishError(
                f"{self.repo_id} does not exist, or this token may not see it, and the token may "
                "not create it: use another token, or create it empty on the Hub, and publish again"
            ) from error

    def head(self, revision: str) -> tuple[str, dict[str, str]]:
        """Return the commit of a revision, and path -> hash of its files: SHA-256, or Git's.

        The Hub names the files twice, in two answers, so that an answer that lacks some is found.
        """

        def asked() -> tuple[str, dict[str, str]]:
            info: Any = self.api.repo_info(
                self.repo_id, repo_type=self.repo_type, revision=revision
            )
            sha = self._required(info.sha)
            if info.siblings is None or (hub.COMMIT.fullmatch(revision) and sha != revision):
                raise hub.WrongAnswerError(f"{self.repo_id}: the Hub does not describe {revision}")
            entries = self.api.list_repo_tree(
                self.repo_id, repo_type=self.repo_type, revision=sha, recursive=True
            )
            tree: dict[str, str] = {}
            seen = set()
            for entry in entries:
                if entry.path in seen:  # As if the first page came after the last.
                    raise hub.WrongAnswerError(f"{self.repo_id}: the Hub lists {entry.path} twice")
                seen.add(entry.path)
                if isinstance(entry, RepoFile):
                    tree[entry.path] = entry.lfs.sha256 if entry.lfs else entry.blob_id
            if {each.rfilename for each in info.siblings} - tree.keys():
                raise hub.WrongAnswerError(
                    f"the Hub lists other files of {self.repo_id} than it names"
                )
            return sha, tree

        return hub.repeated(asked)

    def plan(self, files: Files, commit: str, tree: Mapping[str, str]) -> Plan:
        """Return what to change in a commit so that it holds these files."""
        keep = [path for path, file in files.items() if file.is_at(tree.get(path))]
        add = [path for path in files if path not in keep]
        ours = self._released(files, commit, {p: tree[p] for p in sorted(tree.keys() - {*keep})})
        others = [path for path in add if path in tree and path not in ours]
        if others == ["README.md"] and tree.keys() <= {"README.md", ".gitattributes"}:
            text = self.content("README.md", commit, tree["README.md"]).decode(errors="replace")
            others = [] if MADE_BY_THE_HUB.fullmatch(text) else others
        return Plan(files, add, keep, sorted(ours - files.keys()), others)

    def _released(self, files: Files, commit: str, tree: Mapping[str, str]) -> set[str]:
        """Return the files of a commit that a release of this kind wrote, unchanged since.

        Others are neither replaced nor deleted.
        """
        if Sums.FILE not in tree:
            return set()
        self.content(Sums.FILE, commit, tree[Sums.FILE])
        try:
            own = Sums.read(hub.snapshot_of(self.repo_id, self.repo_type, commit))
        except DatasetError:  # It is another program's.
            return set()
        names = {name for name, _ in own.hashes}
        mark = next((m for m in MARKS if any(fnmatch(name, m) for name in names)), None)
        if mark is None or not any(fnmatch(path, mark) for path in files):
            return set()

        def is_released(path: str) -> bool:
            digest = tree[path]
            if path in names and len(digest) != 64:  # It is Git's.
                digest = hashlib.sha256(self.content(path, commit, digest)).hexdigest()
            return (path, digest) in own.hashes

        return {Sums.FILE, *filter(is_released, tree)}

    def content(self, path: str, commit: str, digest: str) -> bytes:
        """Return a file of a commit, which has to have the hash that the Hub lists for it."""
        local = hub.download(self.repo_id, self.repo_type, commit, [path]) / path

        def is_whole() -> bool:
            if not local.is_file():
                return False
            content = local.read_bytes()
            return digest in (git_hash(content), hashlib.sha256(content).hexdigest())

        if not is_whole() and not (hub.download_again(local) and is_whole()):
            raise PublishError(f"{self.repo_id}: the Hub lists {path}, but gives another content")
        return local.read_bytes()

    def tags(self) -> dict[str, str]:
        """Return the commit that each tag points to."""

        def asked() -> dict[str, str]:
            refs = self.api.list_repo_refs(self.repo_id, repo_type=self.repo_type)
            return {str(tag.name): self._required(tag.target_commit) for tag in refs.tags}

        return hub.repeated(asked)

    def versions(self) -> dict[str, str]:
        """Return the commit of each tag that is a version, such as 1.0.0."""
        return {tag: commit for tag, commit in self.tags().items() if VERSION.fullmatch(tag)}

    def has(self, files: Files, version: str) -> bool:
        """Return whether these files are already tagged with the version, and print so.

        Raises:
            PublishError: The tag has other data, or a later version is released already.
        """
        versions = self.versions()
        tagged = versions.get(version)
        if tagged is None:
            newest = max([version, *versions], key=number)
            if newest != version:
                raise PublishError(
                    f"publish.version={version}: {self.repo_id} has {newest} already: choose a "
                    "later version"
                )
            return False
        plan = self.plan(files, *self.head(tagged))
        changed = [*plan.add, *plan.delete]
        if data := [path for path in changed if not CARD.fullmatch(path)]:
            raise PublishError(
                f"the tag {version} of {self.repo_id} is at {tagged[:12]}, with other data "
                f"({data[0]}): choose another publish.version"
            )
        card = ", with a different card" if changed else ""
        say(f"{version} is published already, at {tagged[:12]}{card}.")
        return True

    def commit(self, title: str, plan: Plan, parent: str) -> str:
        """Upload missing contents, commit all changes at once, and return the commit.

        After an error, the branch tells a commit whose answer was lost from a refused one.
        """
        added = [(path, plan.files[path]) for path in plan.add]
        # One by one, so that a run after an interruption does not send a file again.
        uploaded = starmap(self._uploaded, added)
        finished = tracked(uploaded, "upload", plan.bytes, lambda pair: pair[0])
        additions = [addition for _, addition in finished]
        deletions = [CommitOperationDelete(path, is_folder=False) for path in plan.delete]

        def committed() -> str:
            try:
                made = self.api.create_commit(
                    self.repo_id,
                    [*additions, *deletions],
                    commit_message=title,
                    repo_type=self.repo_type,
                    parent_commit=parent,
                )
                return self._required(made.oid)
            except hub.FAILED as error:
                status = hub.status_of(error)
                is_refused = status == 412
                if status and not is_refused and hub.seconds_to_wait(error) is None:
                    raise
                head, landed = self.landed(title, plan, parent)
                if landed:
                    return landed
                if head != parent:
                    raise PublishError(reasons(self.repo_id)[412]) from error
                if is_refused:
                    raise hub.WrongAnswerError(
                        f"{self.repo_id}: the Hub does not say whether the release was committed: "
                        "publish again, which finds it or completes it"
                    ) from error
                raise

        return hub.repeated(committed)

    def _uploaded(self, path: str, file: File) -> tuple[int, CommitOperationAdd]:
        """Upload a file that is listed, unless the commit itself will hold it."""
        size = file.size
        content = file.content() if size <= IN_MEMORY else str(file.source)
        addition = CommitOperationAdd(path_in_repo=path, path_or_fileobj=content)

        def upload() -> None:
            self.api.preupload_lfs_files(self.repo_id, [addition], repo_type=self.repo_type)

        hub.repeated(upload)
        if size > IN_MEMORY:
            file.require(addition.upload_info.sha256.hex())
        return size, addition

    def landed(self, title: str, plan: Plan, parent: str = "") -> tuple[str, str]:
        """Return the head of `main`, and the commit after `parent` that made a release, or ""."""
        commits = self._call("list_repo_commits", revision="main")
        for commit in commits:
            if commit.commit_id == parent:
                break
            if commit.title == title and not plan.missed_by(self.head(commit.commit_id)[1]):
                return str(commits[0].commit_id), str(commit.commit_id)
        return str(commits[0].commit_id), ""

    def require(self, plan: Plan, commit: str) -> None:
        """Raise PublishError if a commit has other files than were planned."""

        def compared() -> None:
            if wrong := plan.missed_by(self.head(commit)[1]):
                raise hub.WrongAnswerError(f"{wrong[0]} is not the one that was published")

        try:
            hub.repeated(compared)
        except (hub.WrongAnswerError, HTTPError) as error:
            why = f"the verification of {commit[:12]} failed, so it is not tagged"
            raise PublishError(f"{why}: {hub.reason_of(error)}") from error

    def tag(self, tag: str, commit: str) -> None:
        """Create a tag at a commit, unless it is there already.

        Raises:
            PublishError: The tag points to another commit.
        """

        def tagged() -> str:
            if tag not in self.tags():
                try:
                    self._call("create_tag", tag=tag, revision=commit)
                except HfHubHTTPError as error:
                    # It exists: our first answer was lost, or another user created it.
                    if hub.status_of(error) != 409:
                        raise
            if tag not in (tags := self.tags()):
                raise hub.WrongAnswerError(
                    f"{self.repo_id}: the Hub does not list the tag {tag} yet: publish again"
                )
            return tags[tag]

        if (target := hub.repeated(tagged)) != commit:
            raise PublishError(
                f"the tag {tag} of {self.repo_id} points to {target[:12]}, not to the release "
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
