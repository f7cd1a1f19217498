"""The stage `publish`: releases a dataset, its export, its environment and a policy on the Hub.

Each has its own repository. A release is one atomic commit: plan, upload of the contents, one
commit on a checked parent, verification of the commit from an empty cache, and last the tag. At
every moment `main` holds either the old release or the new one, complete. Running the stage again
completes an interrupted release, or prints that the release is done.
"""

from __future__ import annotations

import logging
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path

from huggingface_hub import CommitOperationAdd, CommitOperationDelete, HfApi
from huggingface_hub.utils import disable_progress_bars  # type: ignore[attr-defined]

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.hub import limit_silence
from pipeline.config.publish import PublishOptions
from pipeline.config.run import Run
from pipeline.inspection import front_matter
from pipeline.machinery.artifact import Sums
from pipeline.machinery.console import say, tracked
from pipeline.release.card import write_card
from pipeline.release.derived import KINDS as EXPORTS
from pipeline.release.derived import loading, stage_environment, stage_export
from pipeline.release.faults import FAULTS, PublishError, explained, reasons, repeated
from pipeline.release.files import files_of, left_out
from pipeline.release.model import published_dataset, stage_policy
from pipeline.release.plan import DATASET, ENVIRONMENT, MODEL, Kind, Plan, make_plan
from pipeline.release.provenance import Release
from pipeline.release.remote import Remote, UnseenRemote, number, why_unseen
from pipeline.release.verify import verified


def run(run: Run) -> None:
    """Publish everything that the options of a run name.

    Raises:
        PublishError: The Hub refuses, or does not hold afterwards what was sent.
        DatasetError: The dataset, the export or the run is missing, unfinished or damaged.
        ConfigError: The dataset lacks a split whose export is to be published.
    """
    for client in ("httpx", "httpx2"):  # Each request would be a line on the terminal.
        logging.getLogger(client).setLevel(logging.WARNING)
    limit_silence()
    disable_progress_bars()  # The client has one per file; we show one for all.
    options, api = run.options.publish, HfApi()
    unseen = options.dry_run and _is_unseen(api, options)
    remote_of, hub = (UnseenRemote, None) if unseen else (Remote, api)
    if id_ := options.repo_id:
        with explained(id_):
            _dataset(run, remote_of(api, id_, DATASET))

    def release(repo_id: str, kind: Kind, stage: Callable[[Path], None], load: str) -> None:
        """Release the files that `stage` writes into a folder, and print how to load them."""
        with explained(repo_id), tempfile.TemporaryDirectory(prefix="labyrinth-release-") as place:
            folder = Path(place)
            stage(folder)
            Sums.of(folder).write()
            if _release(remote_of(api, repo_id, kind), options, folder, nullcontext(folder)):
                say(load)

    if id_ := options.export:
        kind = EXPORTS[run.options.export.format]
        release(id_, kind, lambda folder: stage_export(run, folder, hub), loading(run))
    if id_ := options.env:
        origin, load = published_dataset(run, hub), f'make_env("{id_}", trust_remote_code=True)'
        release(id_, ENVIRONMENT, lambda folder: stage_environment(run, folder, *origin), load)
    if id_ := options.model:
        load = f'load_policy("{id_}", revision="{options.version}")'
        origin = published_dataset(run, hub)
        release(id_, MODEL, lambda folder: stage_policy(run, folder, *origin), load)


def _is_unseen(api: HfApi, options: PublishOptions) -> bool:
    """Return whether the Hub cannot be queried, and print why."""
    given = options.repo_id or options.export or options.env or options.model
    with explained(given):
        reason = why_unseen(api, given)
    if reason:
        say(
            f"cannot query the Hub ({reason}), so the plan is for a new repository; "
            "scripts/local_hub starts a Hub on this machine, for rehearsals."
        )
    return bool(reason)


def _dataset(run: Run, remote: Remote) -> None:
    """Release all finished datasets of a folder with their card, and print how to load them."""
    manifests = front_matter.finished(run.local_dir)
    if not manifests:
        reason = "holds no finished dataset: labyrinth-datasets makes one"
        raise PublishError(f"{run.local_dir} {reason}")
    options = run.options.publish
    if _release(remote, options, run.local_dir, _carded(run, remote)):
        config = front_matter.default_config(manifests)
        say(f'load_dataset("{options.repo_id}", "{config}", revision="{options.version}")')


@contextmanager
def _carded(run: Run, remote: Remote) -> Iterator[Path]:
    """Yield the folder with the card of the release; for a dry run, a temporary copy of it."""
    options = run.options.publish

    def create() -> None:
        """Create the repository before the card is written, as the token may not be allowed to."""
        if not options.dry_run and not remote.exists():
            remote.create(private=options.private)

    def card(folder: Path) -> None:
        release = Release(options.repo_id, options.version, options.export or None)
        write_card(folder, release, workers=run.options.workers, first=create)

    if not options.dry_run:
        card(run.local_dir)
        yield run.local_dir
        return
    with tempfile.TemporaryDirectory(prefix="labyrinth-dry-run-") as temporary:
        folder = Path(temporary)
        # Shards are linked, as they are only read; writing to a link would change its target.
        shutil.copytree(
            run.local_dir.resolve(),
            folder,
            copy_function=lambda file, copy: (
                os.symlink if Path(file).suffix == ".parquet" else shutil.copyfile
            )(file, copy),
            dirs_exist_ok=True,
            ignore=shutil.ignore_patterns(".*"),  # A build, or a lock.
        )
        try:
            card(folder)
        except DatasetError as error:
            raise DatasetError(str(error).replace(temporary, str(run.local_dir))) from error
        yield folder


def _release(
    remote: Remote, options: PublishOptions, folder: Path, staged: AbstractContextManager[Path]
) -> bool:
    """Release files, and return whether they are released and tagged now.

    Args:
        remote: The repository.
        options: The options of the release.
        folder: The folder with the files as they are, which may be published already.
        staged: Yields the folder with the files of this release; used unless they are published.
    """
    exists = remote.exists()
    # Before the card is written, which could describe a version that is already taken.
    done = exists and _is_published(folder, remote, options)
    if not done:
        with staged as ready:
            done = _commit_and_tag(ready, remote, options, exists)
    if not done or options.dry_run:
        return False
    _follow(remote, options.version)
    return True


def _follow(remote: Remote, version: str) -> None:
    """Move the tag from which a library reads the newest release, if the kind has such a tag."""
    if tag := remote.kind.newest_tag:
        versions = remote.versions()
        if version == max(versions, key=number):
            remote.move_tag(tag, versions[version])
            say(f"tagged {tag}, as the newest release, at {versions[version][:12]}.")


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
    plan = _plan(remote, files_of(remote.kind, folder), tagged)
    if plan.data:
        raise PublishError(
            f"the tag {options.version} of {remote.repo_id} is at {tagged[:12]}, with other data "
            f"({plan.data[0]}): choose another publish.version"
        )
    card = "" if plan.is_done else ", with a different card"
    say(f"{options.version} is published already, at {tagged[:12]}{card}.")
    return True


def _commit_and_tag(folder: Path, remote: Remote, options: PublishOptions, exists: bool) -> bool:
    """Commit, verify and tag a folder, and return True; in a dry run, print and return False.

    Raises:
        PublishError: The Hub refuses, or does not hold afterwards what was sent.
    """
    if not exists and not options.dry_run:
        remote.create(private=options.private)
    head = remote.commit("main") if exists or not options.dry_run else ""
    files = files_of(remote.kind, folder)
    plan = _plan(remote, files, head)
    if plan.others and not remote.is_new(head):
        raise PublishError(
            f"{remote.repo_id} holds files that no release of this kind wrote, or changed since "
            f"({', '.join(plan.others[:3])}): rename or delete them there, or choose another id"
        )
    # The folders of the other kinds hold only files to publish.
    if remote.kind is DATASET and (others := list(left_out(folder, list(files)))):
        say(f"not part of the release, and not published: {', '.join(others)}.")
    _print_plan(plan, remote, options, exists)
    if options.dry_run:
        return False
    if not plan.is_done:
        head = _commit(remote, f"Release {options.version}", plan, head)
    say(verified(remote.repo_id, head, folder, remote.kind))
    remote.tag(options.version, head)
    say(f"tagged {options.version} at {head[:12]}.")
    return True


def _plan(remote: Remote, files: Mapping[str, Path], commit: str) -> Plan:
    """Return the changes that give a commit these files; `commit` is empty if none exists."""
    tree = remote.tree(commit) if commit else {}
    return make_plan(remote.kind, files, tree, partial(remote.released, commit))


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
            if make_plan(plan.kind, plan.files, remote.tree(head)).is_done:
                return head
            raise PublishError(reasons(remote.repo_id)[412]) from error
        return str(info.oid)

    return repeated(commit)
