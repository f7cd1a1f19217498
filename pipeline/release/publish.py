"""The stage `publish`: releases a dataset, its export, its environment and a policy on the Hub.

Each has its own repository. A release is one atomic commit: plan, upload of the contents, one
commit on a checked parent, verification of the commit from an empty cache, and last the tag. At
every moment `main` holds either the old release or the new one, complete. Running the stage again
completes an interrupted release, or prints that the release is done.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path

from huggingface_hub import CommitOperationAdd, CommitOperationDelete, HfApi
from huggingface_hub.utils import disable_progress_bars  # type: ignore[attr-defined]

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.hub import prepare_client
from pipeline.config.stage import Job
from pipeline.inspection import front_matter
from pipeline.machinery.artifact import Sums
from pipeline.machinery.console import say, tracked
from pipeline.release.card import write_card
from pipeline.release.derived import KINDS as EXPORTS
from pipeline.release.derived import loading, stage_environment, stage_export
from pipeline.release.faults import FAULTS, PublishError, explained, reasons, repeated
from pipeline.release.files import card_files, files_of, left_out
from pipeline.release.model import published_dataset, stage_policy
from pipeline.release.options import PublishOptions, PublishStageOptions
from pipeline.release.remote import (
    DATASET,
    ENVIRONMENT,
    MODEL,
    Kind,
    Plan,
    Remote,
    differing,
    is_unseen,
    number,
)
from pipeline.release.texts import Release
from pipeline.release.verify import verified


def run(job: Job[PublishStageOptions]) -> None:
    """Publish everything that the options of a run name.

    Raises:
        PublishError: The Hub refuses, or does not hold afterwards what was sent.
        DatasetError: The dataset, the export or the run is missing, unfinished or damaged.
        ConfigError: The dataset lacks a split whose export is to be published.
    """
    for client in ("httpx", "httpx2"):  # Each request would be a line on the terminal.
        logging.getLogger(client).setLevel(logging.WARNING)
    prepare_client()
    disable_progress_bars()  # The client has one per file; we show one for all.
    options, api = job.options.publish, HfApi()
    first = options.repo_id or options.export or options.env or options.model
    with explained(first):
        unseen = options.dry_run and is_unseen(api, first)
    hub = None if unseen else api
    if id_ := options.repo_id:
        with explained(id_):
            _dataset(job, Remote(api, id_, DATASET, unseen))

    def release(repo_id: str, kind: Kind, stage: Callable[[Path], None], load: str) -> None:
        """Release the files that `stage` writes into a folder, and print how to load them."""
        with explained(repo_id), tempfile.TemporaryDirectory(prefix="labyrinth-release-") as place:
            folder = Path(place)
            stage(folder)
            Sums.of(folder).write()
            remote = Remote(api, repo_id, kind, unseen)
            _release(remote, options, folder, nullcontext(folder), load)

    if id_ := options.export:
        kind = EXPORTS[job.options.export.format]
        release(id_, kind, lambda folder: stage_export(job, folder, hub), loading(job))
    if id_ := options.env:
        origin, load = published_dataset(job, hub), f'make_env("{id_}", trust_remote_code=True)'
        release(id_, ENVIRONMENT, lambda folder: stage_environment(job, folder, *origin), load)
    if id_ := options.model:
        load = f'load_policy("{id_}", revision="{options.version}")'
        origin = published_dataset(job, hub)
        release(id_, MODEL, lambda folder: stage_policy(job, folder, *origin), load)


def _dataset(job: Job[PublishStageOptions], remote: Remote) -> None:
    """Release all finished datasets of a folder with their card, and print how to load them."""
    manifests = front_matter.finished(job.local_dir)
    if not manifests:
        reason = "holds no finished dataset: labyrinth-datasets makes one"
        raise PublishError(f"{job.local_dir} {reason}")
    options, config = job.options.publish, front_matter.default_config(manifests)
    load = f'load_dataset("{options.repo_id}", "{config}", revision="{options.version}")'
    _release(remote, options, job.local_dir, _carded(job, remote), load)


@contextmanager
def _carded(job: Job[PublishStageOptions], remote: Remote) -> Iterator[Path]:
    """Yield the folder with the card of the release; for a dry job, a temporary copy of it."""
    options = job.options.publish
    release = Release(options.repo_id, options.version, options.export or None)
    workers, overwrite = job.options.workers, job.options.overwrite
    card = partial(write_card, release=release, workers=workers, overwrite=overwrite)
    if not options.dry_run:
        # The repository comes before the card is written, as the token may not be allowed to.
        card(job.local_dir, first=partial(remote.create, private=options.private))
        yield job.local_dir
        return
    with tempfile.TemporaryDirectory(prefix="labyrinth-dry-run-") as temporary:
        folder = Path(temporary)
        # Links are enough: the files are read, and the card replaces links, not their targets.
        for name in card_files(job.local_dir):
            link = folder / name
            link.parent.mkdir(exist_ok=True)
            link.symlink_to((job.local_dir / name).resolve())
        try:
            card(folder)
        except DatasetError as error:
            raise DatasetError(str(error).replace(temporary, str(job.local_dir))) from error
        yield folder


def _release(
    remote: Remote,
    options: PublishOptions,
    folder: Path,
    staged: AbstractContextManager[Path],
    load: str,
) -> None:
    """Release files.

    Args:
        remote: The repository.
        options: The options of the release.
        folder: The folder with the files as they are, which may be published already.
        staged: Yields the folder with the files of this release; used unless they are published.
        load: The line that loads the release, to print at the end.
    """
    exists = remote.exists()
    # Before the card is written, which could describe a version that is already taken.
    if not (exists and _is_published(folder, remote, options)):
        with staged as ready:
            _commit_and_tag(ready, folder, remote, options, exists)
    if options.dry_run:
        return
    if tag := remote.kind.newest_tag:
        versions = remote.versions()
        if options.version == max(versions, key=number):
            commit = versions[options.version]
            remote.move_tag(tag, commit)
            say(f"tagged {tag}, as the newest release, at {commit[:12]}.")
    say(load)


def _is_published(folder: Path, remote: Remote, options: PublishOptions) -> bool:
    """Return whether these files are already tagged with the version.

    Raises:
        PublishError: The tag has other data, or a later version is released already.
    """
    versions = remote.versions()
    tagged = versions.get(options.version)
    if tagged is None:
        newest = max([options.version, *versions], key=number)
        if newest != options.version:
            raise PublishError(
                f"publish.version={options.version}: {remote.repo_id} has {newest} already: "
                "choose a later version"
            )
        return False
    changed = remote.plan(files_of(folder), tagged).changed
    if data := [path for path in changed if remote.kind.is_data(path)]:
        raise PublishError(
            f"the tag {options.version} of {remote.repo_id} is at {tagged[:12]}, with other data "
            f"({data[0]}): choose another publish.version"
        )
    card = ", with a different card" if changed else ""
    say(f"{options.version} is published already, at {tagged[:12]}{card}.")
    return True


def _commit_and_tag(
    folder: Path, source: Path, remote: Remote, options: PublishOptions, exists: bool
) -> None:
    """Commit, verify and tag a folder; in a dry job, only print the plan.

    Args:
        folder: The folder with the files of the release.
        source: The user's folder, in which other files may be.
        remote: The repository.
        options: The options of the release.
        exists: Whether the repository exists.

    Raises:
        PublishError: The Hub refuses, or does not hold afterwards what was sent.
    """
    if not options.dry_run:
        remote.create(private=options.private)
    head = remote.commit("main") if exists or not options.dry_run else ""
    files = files_of(folder)
    plan = remote.plan(files, head)
    if plan.others and not remote.is_new(head):
        raise PublishError(
            f"{remote.repo_id} holds files that no release of this kind wrote, or changed since "
            f"({', '.join(plan.others[:3])}): rename or delete them there, or choose another id"
        )
    # The folders of the other kinds hold only files to publish.
    if remote.kind is DATASET and (others := list(left_out(source, list(files)))):
        say(f"not part of the release, and not published: {', '.join(others)}.")
    _print_plan(plan, remote, options, exists)
    if options.dry_run:
        return
    if plan.changed:
        head = _commit(remote, f"Release {options.version}", plan, head)
    say(verified(remote.repo_id, head, folder, remote.kind.repo_type))
    remote.tag(options.version, head)
    say(f"tagged {options.version} at {head[:12]}.")


def _print_plan(plan: Plan, remote: Remote, options: PublishOptions, exists: bool) -> None:
    if options.dry_run:
        for word, paths in (("add", plan.add), ("keep", plan.keep), ("delete", plan.delete)):
            for path in paths:
                say(f"  {word:6} {path}")
    new = "" if exists else f" (to be created, {'private' if options.private else 'public'})"
    say(
        f"{remote.repo_id}{new}: {len(plan.add)} files to add ({plan.bytes / 1e6:.2f} MB), "
        f"{len(plan.keep)} to keep, {len(plan.delete)} to delete; new tag: "
        f"{options.version}."
    )


def _commit(remote: Remote, title: str, plan: Plan, parent: str) -> str:
    """Upload missing contents, commit all changes at once, and return the commit.

    After an error, reading the branch tells a commit whose answer was lost from a refused one.
    """

    def uploaded(path: str) -> tuple[int, CommitOperationAdd]:
        addition = CommitOperationAdd(path_in_repo=path, path_or_fileobj=plan.files[path])
        remote.api.preupload_lfs_files(remote.repo_id, [addition], repo_type=remote.kind.repo_type)
        return plan.files[path].stat().st_size, addition

    # One by one, so that a run after an interruption does not send a file again.
    additions = list(tracked(map(uploaded, plan.add), "upload", total=plan.bytes))
    deletions = [CommitOperationDelete(path, is_folder=False) for path in plan.delete]

    def commit() -> str:
        try:
            info = remote.api.create_commit(
                remote.repo_id,
                [*additions, *deletions],
                commit_message=title,
                repo_type=remote.kind.repo_type,
                parent_commit=parent,
            )
        except FAULTS as error:
            head = remote.commit("main")
            if head == parent:
                raise
            if differing(plan.files, remote.tree(head)):
                raise PublishError(reasons(remote.repo_id)[412]) from error
            return head
        return str(info.oid)

    return repeated(commit)
