"""The stage `publish`: a dataset, a policy and a report, each in a repository of its own.

Each is released as `releasing` has it; a policy and a report name the dataset that they are of.
"""

from __future__ import annotations

import logging
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from huggingface_hub import HfApi, constants
from huggingface_hub.utils import disable_progress_bars  # type: ignore[attr-defined]

from labyrinth_core.data.errors import DatasetError
from pipeline.config.run import PublishOptions, Run
from pipeline.inspection import front_matter
from pipeline.machinery.console import say
from pipeline.release.card import write_card
from pipeline.release.model import staged_policy
from pipeline.release.plan import DATASET, MODEL, SPACE
from pipeline.release.releasing import release
from pipeline.release.remote import PublishError, Remote, explained
from pipeline.release.space import staged_report


def run(run: Run) -> None:
    """Publish what the options of a run name: its data_dir, its policy, its report.

    Raises:
        PublishError: The Hub refuses, or what it holds afterwards is not what was sent.
        DatasetError: The folder has no finished dataset, run or report, or a damaged one.
    """
    for client in ("httpx", "httpx2"):  # Each request would be a line on the terminal.
        logging.getLogger(client).setLevel(logging.WARNING)
    disable_progress_bars()  # One of theirs for each file, instead of ours for all.
    options, api = run.options.publish, HfApi()
    if options.repo_id:
        with explained(options.repo_id):
            _publish_dataset(run, Remote(api, options.repo_id, DATASET))
    if options.model:
        with explained(options.model), staged_policy(run, api) as folder:
            remote = Remote(api, options.model, MODEL)
            if release(remote, options, folder, nullcontext(folder)):
                say(f'load_policy("{options.model}", revision="{options.version}")')
    if options.space:
        with explained(options.space), staged_report(run) as folder:
            remote = Remote(api, options.space, SPACE)
            if release(remote, options, folder, nullcontext(folder)):
                say(f"{constants.ENDPOINT}/spaces/{options.space}")


def _publish_dataset(run: Run, remote: Remote) -> None:
    options = run.options.publish
    if not front_matter.finished(run.local_dir):
        reason = "holds no finished dataset: labyrinth-datasets makes one"
        raise PublishError(f"{run.local_dir} {reason}")
    if release(remote, options, run.local_dir, _carded(run, options)):
        config = front_matter.default_config(front_matter.finished(run.local_dir))
        say(f'load_dataset("{options.repo_id}", "{config}", revision="{options.version}")')


@contextmanager
def _carded(run: Run, options: PublishOptions) -> Iterator[Path]:
    """Yield the folder with the card of the release; for a dry run, another that looks like it."""

    def card(folder: Path) -> None:
        write_card(
            folder,
            options.repo_id,
            options.version,
            space=options.space or None,
            workers=run.options.workers,
        )

    if not options.dry_run:
        card(run.local_dir)
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
            card(folder)
        except DatasetError as error:
            raise DatasetError(str(error).replace(temporary, str(run.local_dir))) from error
        yield folder
