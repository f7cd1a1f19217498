"""The release of a dataset to the Hugging Face Hub: one atomic commit, verified, then tagged.

Plan, upload of the blobs, one commit on a checked parent, verification by commit from an empty
cache in another process, the tag last of all. `main` holds the old release or the new one, whole,
at every moment, and running it again completes what an interruption left, or says that it is done.
"""

from __future__ import annotations

import hashlib
import logging
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pipeline import front_matter
from pipeline.config import PublishOptions, Run
from pipeline.manifest import MANIFEST, DatasetError, file_sha256
from pipeline.release.card import published_files, write_card
from pipeline.terminal import console, tracked

if TYPE_CHECKING:
    from huggingface_hub import CommitOperationAdd, HfApi

OURS = (
    "README.md",
    "CHANGELOG.md",
    "CITATION.cff",
    "SHA256SUMS",
    "croissant.json",
    "pictures/*.png",
    f"*/{MANIFEST}",
    "*/*.parquet",
)
"""What a release may have put on the Hub; other files are somebody else's and left alone."""

DATA = (f"*/{MANIFEST}", "*/*.parquet")
"""The part of a release that is not its card."""

ATTEMPTS = 4
"""Tries of a commit that the Hub answers with a fault of its own."""


class PublishError(DatasetError):
    """A release that could not be made, in one line."""


class RemoteFile(NamedTuple):
    """A file on the Hub."""

    digest: str
    """SHA-256 of a large file; for others the hash that git gives a blob."""
    large: bool


@dataclass(frozen=True)
class Plan:
    """What a release would change."""

    files: dict[str, Path]
    """All files of the release, by their path on the Hub."""
    add: list[str]
    keep: list[str]
    delete: list[str]

    @property
    def bytes(self) -> int:
        """The size of what has to be sent."""
        return sum(self.files[path].stat().st_size for path in self.add)

    @property
    def is_done(self) -> bool:
        """Whether nothing differs."""
        return not self.add and not self.delete


def run(run: Run) -> None:
    """Publish the data_dir of a run.

    Raises:
        PublishError: The Hub refuses, or what it holds afterwards is not what was sent.
        DatasetError: The folder has no finished dataset, or a damaged one.
    """
    options = run.publish
    assert options is not None  # `resolve` has seen to it.
    if not options.dry_run:
        write_card(run.data_dir, options.repo_id, options.version, workers=run.workers)
    manifests = front_matter.finished(run.data_dir)
    if not manifests:
        raise PublishError(f"{run.data_dir} holds no finished dataset: python run.py makes one")
    files = {
        path.relative_to(run.data_dir).as_posix(): path
        for path in published_files(run.data_dir, manifests)
    }
    with _explained(options):
        _publish(run.data_dir, files, options)


def _publish(data_dir: Path, files: dict[str, Path], options: PublishOptions) -> None:
    from huggingface_hub import HfApi

    for client in ("httpx", "httpx2"):  # Each request would be a line on the terminal.
        logging.getLogger(client).setLevel(logging.WARNING)
    api = HfApi()
    owner = _check_token(api)
    exists = bool(api.repo_exists(options.repo_id, repo_type="dataset"))
    if exists:
        api.auth_check(options.repo_id, repo_type="dataset", write=True)
        if _is_published(api, files, options):
            return
    remote, head = _remote(api, options) if exists else ({}, "")
    plan = make_plan(files, remote)
    _print_plan(plan, options, exists)
    if options.dry_run:
        return
    if not exists:
        api.create_repo(options.repo_id, repo_type="dataset", private=options.private)
    if options.branch != "main":
        api.create_branch(
            options.repo_id, branch=options.branch, repo_type="dataset", exist_ok=True
        )
    if not exists:
        remote, head = _remote(api, options)
        plan = make_plan(files, remote)
    if not plan.is_done:
        head = _commit(api, options, plan, head)
    if options.create_pr:
        console.print(f"pull request: {head}; publish again, to tag, once it is merged.")
        return
    _verify(options, data_dir, head)
    _tag(api, options, head)
    if options.collection:
        _collect(api, options, options.collection, owner)
    config = front_matter.default_config(front_matter.finished(data_dir))
    console.print(
        f'load_dataset("{options.repo_id}", "{config}", revision="{options.version}")',
        markup=False,
        soft_wrap=True,
    )


def _is_published(api: HfApi, files: dict[str, Path], options: PublishOptions) -> bool:
    """Return whether the tag is there already, on these data.

    Raises:
        PublishError: It is there on others.
    """
    tagged = _tagged(api, options)
    if tagged is None:
        return False
    plan = make_plan(files, _tree(api, options, tagged))
    if any(_matches(path, DATA) for path in [*plan.add, *plan.delete]):
        raise PublishError(
            f"the tag {options.version} of {options.repo_id} is at {tagged[:12]}, with other "
            "data: choose another publish.version"
        )
    card = "" if plan.is_done else ", with a card that was written otherwise"
    console.print(f"{options.version} is published already, at {tagged[:12]}{card}.")
    return True


def _matches(path: str, patterns: Sequence[str]) -> bool:
    """Return whether a path on the Hub matches a pattern, whose stars stand for no slash."""
    return any(
        fnmatchcase(path, pattern) and path.count("/") == pattern.count("/") for pattern in patterns
    )


def make_plan(files: dict[str, Path], remote: dict[str, RemoteFile]) -> Plan:
    """Return what to change so that the Hub holds these files.

    Args:
        files: By their path on the Hub.
        remote: What it holds now.
    """
    keep = [path for path, local in files.items() if path in remote and _same(local, remote[path])]
    return Plan(
        files=files,
        add=[path for path in files if path not in keep],
        keep=keep,
        delete=[path for path in sorted(remote) if path not in files and _matches(path, OURS)],
    )


def _same(local: Path, remote: RemoteFile) -> bool:
    if remote.large:
        return file_sha256(local) == remote.digest
    content = local.read_bytes()
    header = b"blob %d\0" % len(content)
    # How git names a blob, not a safeguard.
    return hashlib.sha1(header + content, usedforsecurity=False).hexdigest() == remote.digest


def _check_token(api: HfApi) -> str:
    """Return the name of the user that the token belongs to."""
    from huggingface_hub import constants, get_token

    if not get_token():
        raise PublishError(
            f"there is no Hub token: set HF_TOKEN, or run `hf auth login`, "
            f"which leaves one in {constants.HF_TOKEN_PATH}"
        )
    return str(api.whoami()["name"])


def _remote(api: HfApi, options: PublishOptions) -> tuple[dict[str, RemoteFile], str]:
    """Return the files at the head of the branch, and its commit."""
    from huggingface_hub.errors import RevisionNotFoundError

    try:
        info = api.repo_info(options.repo_id, repo_type="dataset", revision=options.branch)
    except RevisionNotFoundError:
        info = api.repo_info(options.repo_id, repo_type="dataset")
    head = str(info.sha)
    return _tree(api, options, head), head


def _tree(api: HfApi, options: PublishOptions, commit: str) -> dict[str, RemoteFile]:
    from huggingface_hub import RepoFile

    entries = api.list_repo_tree(
        options.repo_id, repo_type="dataset", revision=commit, recursive=True
    )
    return {
        entry.path: RemoteFile(entry.lfs.sha256 if entry.lfs else entry.blob_id, bool(entry.lfs))
        for entry in entries
        if isinstance(entry, RepoFile)
    }


def _tagged(api: HfApi, options: PublishOptions) -> str | None:
    """Return the commit that the tag of this version points to, if there is one."""
    refs = api.list_repo_refs(options.repo_id, repo_type="dataset")
    return next((str(tag.target_commit) for tag in refs.tags if tag.name == options.version), None)


def _print_plan(plan: Plan, options: PublishOptions, exists: bool) -> None:
    if options.dry_run:
        for word, paths in (("add", plan.add), ("keep", plan.keep), ("delete", plan.delete)):
            for path in paths:
                console.print(f"  {word:6} {path}", highlight=False, markup=False)
    console.print(
        f"{options.repo_id}{'' if exists else ' (to be created)'}, branch {options.branch}: "
        f"{len(plan.add)} files to add ({plan.bytes / 1e6:.2f} MB), {len(plan.keep)} to keep, "
        f"{len(plan.delete)} to delete; the tag {options.version} is to be made.",
        highlight=False,
        soft_wrap=True,
    )


def _commit(api: HfApi, options: PublishOptions, plan: Plan, parent: str) -> str:
    """Upload what is missing, commit everything at once, and return the commit.

    A lost answer is told from a refused commit by reading the branch again.
    """
    from huggingface_hub import CommitOperationDelete
    from huggingface_hub.errors import HfHubHTTPError, HTTPError  # type: ignore[attr-defined]

    for attempt in range(ATTEMPTS):
        additions = _uploaded(api, options, plan)
        deletions = [CommitOperationDelete(path, is_folder=False) for path in plan.delete]
        try:
            info = api.create_commit(
                options.repo_id,
                [*additions, *deletions],
                commit_message=f"Release {options.version}",
                repo_type="dataset",
                revision=options.branch,
                parent_commit=parent,
                create_pr=options.create_pr,
            )
            return str(info.pr_url if options.create_pr else info.oid)
        except (HfHubHTTPError, HTTPError) as error:
            remote, head = _remote(api, options)
            if head != parent:
                if make_plan(plan.files, remote).is_done:
                    return head
                raise PublishError(
                    f"somebody else committed to {options.repo_id} meanwhile, and nothing was "
                    "changed: look at what they did, and publish again"
                ) from error
            status = _status(error)
            last = attempt == ATTEMPTS - 1
            if last or options.create_pr or (status is not None and 400 <= status < 500):
                raise
            time.sleep(2**attempt)
    raise AssertionError("the last attempt returns or raises")


def _uploaded(api: HfApi, options: PublishOptions, plan: Plan) -> list[CommitOperationAdd]:
    """Return the additions, the content of each large one at the Hub already.

    File by file, so that a run that was stopped has not to send again what it has sent.
    """
    from huggingface_hub import CommitOperationAdd
    from huggingface_hub.utils import disable_progress_bars  # type: ignore[attr-defined]

    disable_progress_bars()  # One of theirs for each file, instead of ours for all.

    def upload(path: str) -> tuple[int, CommitOperationAdd]:
        addition = CommitOperationAdd(path_in_repo=path, path_or_fileobj=plan.files[path])
        api.preupload_lfs_files(
            options.repo_id,
            [addition],
            repo_type="dataset",
            revision=options.branch,
            create_pr=options.create_pr,
        )
        return plan.files[path].stat().st_size, addition

    return list(tracked(map(upload, plan.add), "upload", total=plan.bytes))


def _verify(options: PublishOptions, data_dir: Path, commit: str) -> None:
    """Load the release from the Hub in another process with an empty cache, by its commit."""
    console.print(f"verifying {commit[:12]} from an empty cache ...", highlight=False)
    with tempfile.TemporaryDirectory(prefix="labyrinth-verify-") as home:
        token_path = {"HF_TOKEN": _token()}
        environment = os.environ | token_path | {"HF_HOME": home, "HF_HUB_OFFLINE": "0"}
        for name in ("HF_HUB_CACHE", "HF_DATASETS_CACHE", "HF_ASSETS_CACHE", "HF_XET_CACHE"):
            environment.pop(name, None)
        command = [sys.executable, "-m", "pipeline.release.verify", options.repo_id, commit]
        done = subprocess.run(
            [*command, str(data_dir.resolve())],
            env=environment,
            cwd=Path(__file__).parents[2],
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode:
        last = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]
        raise PublishError(
            f"the verification of {commit[:12]} failed, so it is not tagged: {''.join(last)}"
        )
    console.print(done.stdout.strip(), highlight=False, markup=False)


def _token() -> str:
    from huggingface_hub import get_token

    return get_token() or ""


def _tag(api: HfApi, options: PublishOptions, commit: str) -> None:
    """Tag the commit; a tag that is there already has to be on it."""
    from huggingface_hub.errors import HfHubHTTPError

    if _tagged(api, options) is None:
        try:
            api.create_tag(
                options.repo_id, tag=options.version, revision=commit, repo_type="dataset"
            )
        except HfHubHTTPError as error:
            if _tagged(api, options) is None:
                raise
            console.print(f"the tag was there: {_status(error)}", highlight=False)
    tagged = _tagged(api, options)
    if tagged != commit:
        raise PublishError(
            f"the tag {options.version} of {options.repo_id} points to {str(tagged)[:12]}, not to "
            f"the release at {commit[:12]}: choose another publish.version"
        )
    console.print(f"tagged {options.version} at {commit[:12]}.", highlight=False)


def _collect(api: HfApi, options: PublishOptions, title: str, owner: str) -> None:
    """Put the dataset into the collection with a title, made if need be."""
    namespace = options.repo_id.partition("/")[0] or owner
    collection = api.create_collection(
        title, namespace=namespace, private=options.private, exists_ok=True
    )
    api.add_collection_item(collection.slug, options.repo_id, "dataset", exists_ok=True)


def _status(error: Exception) -> int | None:
    response = getattr(error, "response", None)
    return getattr(response, "status_code", None)


@contextmanager
def _explained(options: PublishOptions) -> Iterator[None]:
    """Turn what the client raises into one line that says what to do."""
    from huggingface_hub.errors import (  # type: ignore[attr-defined]
        HfHubHTTPError,
        HTTPError,
        LocalTokenNotFoundError,
    )

    reasons = {
        401: "the Hub rejects the token: make a new one, and set HF_TOKEN or run `hf auth login`",
        403: f"the token may not write to {options.repo_id}: use one with write access",
        404: f"{options.repo_id} does not exist, or this token may not see it",
        409: f"the Hub reports a conflict for {options.repo_id}: publish again",
        412: f"somebody else committed to {options.repo_id} meanwhile: publish again",
    }
    try:
        yield
    except DatasetError:
        raise
    except LocalTokenNotFoundError as error:
        raise PublishError("there is no Hub token: set HF_TOKEN, or run `hf auth login`") from error
    except HfHubHTTPError as error:
        status = _status(error)
        text = " ".join(str(error).split())
        raise PublishError(reasons.get(status or 0, f"the Hub answers {status}: {text}")) from error
    except (HTTPError, ConnectionError, RuntimeError) as error:
        # What fails while contents are sent comes as a RuntimeError or a ConnectionError.
        endpoint = os.environ.get("HF_ENDPOINT", "the Hub")
        reason = " ".join(str(error.__cause__ or error).split())
        raise PublishError(f"{endpoint} does not answer as it should: {reason}") from error
