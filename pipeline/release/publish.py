"""The stage `publish`: releases a dataset, its export, its environment and a policy on the Hub.

Each is a folder of files with a README.md and a list of hashes, in a repository of its own. A
dataset is released from `data_dir`, where its card is written first; the others are staged in a
temporary folder. `hub` releases them.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Literal

from huggingface_hub import HfApi
from huggingface_hub.utils import disable_progress_bars  # type: ignore[attr-defined]

from labyrinth_core import hub
from pipeline.config import ExportOptions, Job
from pipeline.inspection import front_matter
from pipeline.machinery import Sums, say
from pipeline.release.card import prepared_card
from pipeline.release.derived import loading, stage_environment, stage_export
from pipeline.release.faults import PublishError, explained, is_unseen
from pipeline.release.model import published_dataset, stage_policy
from pipeline.release.options import PublishOptions, PublishStageOptions
from pipeline.release.repository import File, Files, Repository, listed, number
from pipeline.release.texts import Release
from pipeline.release.verify import loaded


def run(job: Job[PublishStageOptions]) -> None:
    """Publish everything that the options of a run name.

    Raises:
        PublishError: The Hub refuses, or does not hold afterwards what was sent.
        DatasetError: The dataset, the export or the run is missing, unfinished or damaged.
        ConfigError: The dataset lacks a split whose export is to be published.
    """
    for client in ("httpx", "httpx2"):  # Each request would be a line on the terminal.
        logging.getLogger(client).setLevel(logging.WARNING)
    hub.prepare_client()
    disable_progress_bars()  # The client has one per file; we show one for all.
    options = job.options.publish
    first = options.repo_id or options.export or options.env or options.model
    with explained(first):
        unseen = options.dry_run and is_unseen(HfApi(), first)
    if id_ := options.repo_id:
        with explained(id_):
            _dataset(job, Repository(HfApi(), id_, "dataset", unseen))

    def staged(
        repo_id: str, repo_type: Literal["dataset", "model"], stage: Callable[[Path], None]
    ) -> None:
        """Release the files that `stage` writes into a folder."""
        with explained(repo_id), tempfile.TemporaryDirectory(prefix="labyrinth-release-") as place:
            stage(folder := Path(place))
            Sums.of(folder).write()
            release(
                options, Repository(HfApi(), repo_id, repo_type, unseen), listed(folder), folder
            )

    if id_ := options.export:
        staged(id_, "dataset", partial(stage_export, job, is_unseen=unseen))
        if job.options.export.format == "lerobot" and not options.dry_run:
            with explained(id_):
                _follow(Repository(HfApi(), id_, "dataset"), options.version)
        _say_how(job, loading(job))
    if options.env or options.model:
        commit, manifest = published_dataset(job, is_unseen=unseen)
    if id_ := options.env:
        staged(id_, "model", lambda folder: stage_environment(job, folder, commit, manifest))
        _say_how(job, f'make_env("{id_}", trust_remote_code=True)')
    if id_ := options.model:
        staged(id_, "model", lambda folder: stage_policy(job, folder, commit, manifest))
        _say_how(job, f'load_policy("{id_}", revision="{options.version}")')


def _say_how(job: Job[PublishStageOptions], load: str) -> None:
    """Print the line that loads a release, unless nothing is released."""
    if not job.options.publish.dry_run:
        say(load)


def _dataset(job: Job[PublishStageOptions], repository: Repository) -> None:
    """Release all finished datasets of a folder with their card, and print how to load them."""
    options, folder = job.options.publish, job.local_dir
    manifests = front_matter.finished(folder)
    if not manifests:
        raise PublishError(f"{folder} holds no finished dataset: labyrinth-datasets makes one")
    repository.exists()  # The token is checked before all shards are read.
    with ExitStack() as until_written:
        card = until_written.enter_context(
            prepared_card(
                folder,
                Release(options.repo_id, options.version, options.export or None),
                workers=job.options.workers,
                overwrite=job.options.overwrite,
                alone=not options.dry_run,
            )
        )

        def write() -> None:
            card.write()
            until_written.close()  # Other processes need not wait for the upload.

        files = {name: File(digest, folder / name) for name, digest in card.sums.hashes}
        own = {**card.files, Sums.FILE: card.sums.content()}
        files |= {name: File.of(content) for name, content in own.items()}
        release(options, repository, files, folder, [*_left_out(folder, files)], write)
    config = front_matter.default_config(manifests)
    _say_how(job, f'load_dataset("{options.repo_id}", "{config}", revision="{options.version}")')


def release(
    options: PublishOptions,
    repository: Repository,
    files: Files,
    folder: Path,
    left_out: Sequence[str] = (),
    before: Callable[[], None] = lambda: None,
) -> None:
    """Release files as a version, or, in a dry run, print the plan.

    Args:
        options: The version, and whether this is a dry run.
        repository: The repository.
        files: The files.
        folder: The folder that they are in.
        left_out: The files of a user beside them, to be named.
        before: Called once the repository exists, before anything is sent.

    Raises:
        PublishError: The Hub refuses, or does not hold afterwards what was sent.
    """
    version, dry_run = options.version, options.dry_run
    files = dict(sorted(files.items()))
    exists = repository.exists()
    if exists and repository.has(files, version):
        return
    if not (exists or dry_run):
        repository.create(private=options.private)
    commit, tree = repository.head("main") if exists or not dry_run else ("", {})
    plan = repository.plan(files, commit, tree)
    if plan.others:
        raise PublishError(
            f"{repository.repo_id} holds files that no release of this kind wrote, or changed "
            f"since ({', '.join(plan.others[:3])}): rename or delete them there, or choose "
            "another id"
        )
    if left_out:
        say(f"not part of the release, and not published: {', '.join(left_out)}.")
    for word, paths in (("add", plan.add), ("keep", plan.keep), ("delete", plan.delete)):
        for path in paths if dry_run else ():
            say(f"  {word:6} {path}")
    new = "" if exists else f" (to be created, {'private' if options.private else 'public'})"
    say(
        f"{repository.repo_id}{new}: {len(plan.add)} files to add ({plan.bytes / 1e6:.2f} MB), "
        f"{len(plan.keep)} to keep, {len(plan.delete)} to delete; new tag: {version}."
    )
    if dry_run:
        return
    before()
    title = f"Release {version}"
    if plan.add or plan.delete:
        commit = repository.commit(title, plan, commit)
    else:  # A run that was interrupted committed it; others may have committed since.
        commit = repository.landed(title, plan)[1] or commit
    say(f"verifying {commit[:12]} ...")
    repository.require(plan, commit)
    loads = loaded(repository.repo_id, repository.repo_type, folder, commit)
    also = f", and {loads}" if loads else ""
    say(f"verified {commit[:12]}: {len(files)} files are those published{also}.")
    repository.tag(version, commit)
    say(f"tagged {version} at {commit[:12]}.")


def _follow(repository: Repository, version: str) -> None:
    """Move the tag that LeRobot reads to the newest release."""
    versions = repository.versions()
    if version == max(versions, key=number):
        tag, commit = ExportOptions.CODEBASE_VERSION, versions[version]
        repository.move_tag(tag, commit)
        say(f"tagged {tag}, as the newest release, at {commit[:12]}.")


def _left_out(folder: Path, files: Files) -> Iterator[str]:
    """Yield the paths in a folder that are not part of a release, except hidden files."""
    folders = {name.partition("/")[0] for name in files if "/" in name}
    for path in sorted(folder.glob("[!.]*")):
        if path.name in folders:
            inside = sorted(each.name for each in path.glob("[!.]*") if each.name != Sums.FILE)
            yield from (f"{path.name}/{n}" for n in inside if f"{path.name}/{n}" not in files)
        elif path.name not in files:
            yield f"{path.name}/" if path.is_dir() else path.name
