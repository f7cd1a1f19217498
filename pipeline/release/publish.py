"""The release of a dataset to the Hugging Face Hub: one atomic commit, verified, then tagged.

Plan, upload of the blobs, one commit on a checked parent, verification by commit from an empty
cache in another process, the tag last of all. `main` holds the old release or the new one, whole,
at every moment, and running it again completes what an interruption left, or says that it is done.
"""

from __future__ import annotations

import logging
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from huggingface_hub import CommitOperationAdd, CommitOperationDelete, HfApi
from huggingface_hub.utils import disable_progress_bars  # type: ignore[attr-defined]

from labyrinth_core.data.errors import DatasetError
from pipeline.config.run import PublishOptions, Run
from pipeline.machinery import front_matter
from pipeline.machinery.console import say, tracked
from pipeline.release.card import write_card
from pipeline.release.plan import Plan, make_plan
from pipeline.release.published import left_out, published_files
from pipeline.release.remote import (
    FAULTS,
    PublishError,
    Remote,
    explained,
    reasons,
    repeated,
)
from pipeline.release.verification import verified

VERSION = re.compile(r"\d+\.\d+\.\d+", re.ASCII)
"""What a tag of a release looks like."""


def run(run: Run) -> None:
    """Publish the data_dir of a run.

    Raises:
        PublishError: The Hub refuses, or what it holds afterwards is not what was sent.
        DatasetError: The folder has no finished dataset, or a damaged one.
    """
    options = run.options.publish
    if not front_matter.finished(run.local_dir):
        reason = "holds no finished dataset: labyrinth-datasets makes one"
        raise PublishError(f"{run.local_dir} {reason}")
    for client in ("httpx", "httpx2"):  # Each request would be a line on the terminal.
        logging.getLogger(client).setLevel(logging.WARNING)
    disable_progress_bars()  # One of theirs for each file, instead of ours for all.
    with explained(options.repo_id):
        _publish(run, Remote(HfApi(), options.repo_id), options)


def _publish(run: Run, remote: Remote, options: PublishOptions) -> None:
    exists = remote.check_access(create_pr=options.create_pr)
    # Before the card is written, which would describe this version as something else.
    done = exists and _is_published(run.local_dir, remote, options)
    if not done:
        with _carded(run, options) as data_dir:
            done = _release(data_dir, remote, options, exists)
    if not done or options.dry_run:
        return
    if options.collection:
        remote.join(options.collection, private=options.private)
        say(f"{options.repo_id} is in the collection {options.collection}.")
    config = front_matter.default_config(front_matter.finished(run.local_dir))
    say(f'load_dataset("{options.repo_id}", "{config}", revision="{options.version}")')


def _release(data_dir: Path, remote: Remote, options: PublishOptions, exists: bool) -> bool:
    """Return whether the folder is released now, and tagged."""
    if not exists and not options.dry_run:
        remote.create(private=options.private)
    head = remote.head(options.branch) if exists or not options.dry_run else ""
    files = _files(data_dir)
    plan = make_plan(files, remote.tree(head) if head else {})
    if others := list(left_out(data_dir, list(files))):
        say(f"not published, since they are no files of the release: {', '.join(others)}.")
    _print_plan(plan, options, exists)
    if options.dry_run:
        return False
    if options.branch != "main":
        remote.create_branch(options.branch)
    if not plan.is_done:
        head = _commit(remote, options, plan, head)
        if options.create_pr:
            say(f"pull request: {head}; publish again, to tag, once it is merged.")
            return False
    say(verified(options.repo_id, head, data_dir))
    remote.tag(options.version, head)
    say(f"tagged {options.version} at {head[:12]}.")
    return True


@contextmanager
def _carded(run: Run, options: PublishOptions) -> Iterator[Path]:
    """Yield the folder with the card of the release; for a dry run, another that looks like it."""
    if not options.dry_run:
        write_card(run.local_dir, options.repo_id, options.version, workers=run.options.workers)
        yield run.local_dir
        return
    with tempfile.TemporaryDirectory(prefix="labyrinth-dry-run-") as temporary:
        folder = Path(temporary)
        # What is written there takes the place of a link, and does not go through it.
        shutil.copytree(
            run.local_dir.resolve(),
            folder,
            copy_function=os.symlink,
            dirs_exist_ok=True,
            ignore=shutil.ignore_patterns(".*"),  # A build, or a lock.
        )
        try:
            write_card(folder, options.repo_id, options.version, workers=run.options.workers)
        except DatasetError as error:
            raise DatasetError(str(error).replace(temporary, str(run.local_dir))) from error
        yield folder


def _files(data_dir: Path) -> dict[str, Path]:
    """Return the files of the release by their paths on the Hub."""
    names = published_files(data_dir, front_matter.finished(data_dir))
    return {name: data_dir / name for name in names}


def _is_published(data_dir: Path, remote: Remote, options: PublishOptions) -> bool:
    """Return whether these data are tagged already.

    Raises:
        PublishError: The tag is on other data, or `main` would go back to an earlier version.
    """
    tags = remote.tags()
    tagged = tags.get(options.version)
    if tagged is None:
        versions = (tag for tag in tags if VERSION.fullmatch(tag))
        newest = max([options.version, *versions], key=_numbers)
        if options.branch == "main" and newest != options.version:
            raise PublishError(
                f"publish.version={options.version}: {options.repo_id} has {newest}, and main does "
                "not go back: choose a later version, or another publish.branch"
            )
        return False
    plan = make_plan(_files(data_dir), remote.tree(tagged))
    if plan.data:
        raise PublishError(
            f"the tag {options.version} of {options.repo_id} is at {tagged[:12]}, with other data "
            f"({plan.data[0]}): choose another publish.version"
        )
    card = "" if plan.is_done else ", with a card that was written otherwise"
    say(f"{options.version} is published already, at {tagged[:12]}{card}.")
    return True


def _numbers(version: str) -> list[int]:
    return [int(number) for number in version.split(".")]


def _print_plan(plan: Plan, options: PublishOptions, exists: bool) -> None:
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
        f"{options.repo_id}{'' if exists else ' (to be created)'}, branch {options.branch}: "
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
                options.repo_id,
                [*additions, *deletions],
                commit_message=f"Release {options.version}",
                repo_type="dataset",
                revision=options.branch,
                parent_commit=parent,
                create_pr=options.create_pr,
            )
        except FAULTS as error:
            head = remote.head(options.branch)
            if head == parent:
                raise
            if make_plan(plan.files, remote.tree(head)).is_done:
                return head
            raise PublishError(reasons(options.repo_id)[412]) from error
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
            options.repo_id,
            [addition],
            repo_type="dataset",
            revision=options.branch,
            create_pr=options.create_pr,
        )
        return plan.files[path].stat().st_size, addition

    return list(tracked(map(upload, plan.add), "upload", total=plan.bytes))
