"""The release of a folder to the Hugging Face Hub: one atomic commit, verified, then tagged.

Plan, upload of the blobs, one commit on a checked parent, verification by commit from an empty
cache in another process, the tag last of all. `main` holds the old release or the new one, whole,
at every moment, and running it again completes what an interruption left, or says that it is done.
"""

from __future__ import annotations

import re
from contextlib import AbstractContextManager
from pathlib import Path

from huggingface_hub import CommitOperationAdd, CommitOperationDelete

from pipeline.config.run import PublishOptions
from pipeline.machinery.console import say, tracked
from pipeline.release.plan import Plan, make_plan
from pipeline.release.published import files_of, left_out
from pipeline.release.remote import (
    FAULTS,
    PublishError,
    Remote,
    reasons,
    repeated,
)
from pipeline.release.verify import verified

VERSION = re.compile(r"\d+\.\d+\.\d+", re.ASCII)
"""What a tag of a release looks like."""


def release(
    remote: Remote, options: PublishOptions, folder: Path, staged: AbstractContextManager[Path]
) -> bool:
    """Return whether files are released now, tagged, and in their collection.

    Args:
        remote: Where they are released.
        options: How they are released.
        folder: The folder with the files as they are, which may be published already.
        staged: Gives the folder with the files of this release, if they are not.

    Raises:
        PublishError: The Hub refuses, or what it holds afterwards is not what was sent.
    """
    exists = remote.check_access(create_pr=options.create_pr)
    # Before the card is written, which would describe this version as something else.
    done = exists and _is_published(folder, remote, options)
    if not done:
        with staged as ready:
            done = _release(ready, remote, options, exists)
    if not done or options.dry_run:
        return False
    if options.collection:
        remote.join(options.collection, private=options.private)
        say(f"{remote.repo_id} is in the collection {options.collection}.")
    return True


def _release(folder: Path, remote: Remote, options: PublishOptions, exists: bool) -> bool:
    """Return whether the folder is released now, and tagged."""
    if not exists and not options.dry_run:
        remote.create(private=options.private)
    head = remote.head(options.branch) if exists or not options.dry_run else ""
    files = files_of(remote.kind, folder)
    plan = make_plan(remote.kind, files, remote.tree(head) if head else {})
    if others := list(left_out(folder, list(files))):
        say(f"not published, since they are no files of the release: {', '.join(others)}.")
    _print_plan(plan, remote, options, exists)
    if options.dry_run:
        return False
    if options.branch != "main":
        remote.create_branch(options.branch)
    if not plan.is_done:
        head = _commit(remote, options, plan, head)
        if options.create_pr:
            say(f"pull request: {head}; publish again, to tag, once it is merged.")
            return False
    say(verified(remote.repo_id, head, folder, remote.kind))
    remote.tag(options.version, head)
    say(f"tagged {options.version} at {head[:12]}.")
    return True


def _is_published(folder: Path, remote: Remote, options: PublishOptions) -> bool:
    """Return whether these files are tagged already.

    Raises:
        PublishError: The tag is on others, or `main` would go back to an earlier version.
    """
    tags = remote.tags()
    tagged = tags.get(options.version)
    if tagged is None:
        versions = (tag for tag in tags if VERSION.fullmatch(tag))
        newest = max([options.version, *versions], key=_numbers)
        if options.branch == "main" and newest != options.version:
            raise PublishError(
                f"publish.version={options.version}: {remote.repo_id} has {newest}, and main does "
                "not go back: choose a later version, or another publish.branch"
            )
        return False
    plan = make_plan(remote.kind, files_of(remote.kind, folder), remote.tree(tagged))
    if plan.data:
        raise PublishError(
            f"the tag {options.version} of {remote.repo_id} is at {tagged[:12]}, with other data "
            f"({plan.data[0]}): choose another publish.version"
        )
    card = "" if plan.is_done else ", with a card that was written otherwise"
    say(f"{options.version} is published already, at {tagged[:12]}{card}.")
    return True


def _numbers(version: str) -> list[int]:
    return [int(number) for number in version.split(".")]


def _print_plan(plan: Plan, remote: Remote, options: PublishOptions, exists: bool) -> None:
    if options.dry_run:
        for word, paths in (("add", plan.add), ("keep", plan.keep), ("delete", plan.delete)):
            for path in paths:
                say(f"  {word:6} {path}")
    tag = (
        "a pull request is not tagged"
        if options.create_pr and not plan.is_done
        else f"the tag {options.version} is to be made"
    )
    say(
        f"{remote.repo_id}{'' if exists else ' (to be created)'}, branch {options.branch}: "
        f"{len(plan.add)} files to add ({plan.bytes / 1e6:.2f} MB), {len(plan.keep)} to keep, "
        f"{len(plan.delete)} to delete; {tag}."
    )


def _commit(remote: Remote, options: PublishOptions, plan: Plan, parent: str) -> str:
    """Upload what is missing, commit everything at once, and return the commit.

    A lost answer is told from a refused commit by reading the branch again.
    """
    additions = _uploaded(remote, options, plan)
    deletions = [CommitOperationDelete(path, is_folder=False) for path in plan.delete]

    def commit() -> str:
        try:
            info = remote.api.create_commit(
                remote.repo_id,
                [*additions, *deletions],
                commit_message=f"Release {options.version}",
                repo_type=remote.kind.name,
                revision=options.branch,
                parent_commit=parent,
                create_pr=options.create_pr,
            )
        except FAULTS as error:
            head = remote.head(options.branch)
            if head == parent:
                raise
            if make_plan(plan.kind, plan.files, remote.tree(head)).is_done:
                return head
            raise PublishError(reasons(remote.repo_id)[412]) from error
        return str(info.pr_url if options.create_pr else info.oid)

    # A pull request may be there in spite of a fault, and would be made a second time.
    return commit() if options.create_pr else repeated(commit)


def _uploaded(remote: Remote, options: PublishOptions, plan: Plan) -> list[CommitOperationAdd]:
    """Return the additions, after the content of each large file was sent to the Hub.

    They are sent one by one, so that a run that was stopped does not send a file again.
    """

    def upload(path: str) -> tuple[int, CommitOperationAdd]:
        addition = CommitOperationAdd(path_in_repo=path, path_or_fileobj=plan.files[path])
        remote.api.preupload_lfs_files(
            remote.repo_id,
            [addition],
            repo_type=remote.kind.name,
            revision=options.branch,
            create_pr=options.create_pr,
        )
        return plan.files[path].stat().st_size, addition

    return list(tracked(map(upload, plan.add), "upload", total=plan.bytes))
