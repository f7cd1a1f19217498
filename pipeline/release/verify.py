"""The last check of a release: a part of its commit is loaded as a user would, with an empty cache.

The clients of the Hub silently fall back on cached files, so this runs in its own process with its
own cache: `python -m pipeline.release.verify REPO COMMIT FOLDER`. Only what it needs is downloaded:
the tree of the commit has been compared with the list already.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from huggingface_hub import get_token
from huggingface_hub.errors import HTTPError  # type: ignore[attr-defined]

from labyrinth_core import hub
from labyrinth_core.data import COLUMNS
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.learning import PolicySpec
from labyrinth_core.policies import load_policy
from labyrinth_core.storage import LocalFile
from pipeline.inspection import front_matter
from pipeline.machinery import end_with_parent, progress
from pipeline.release.faults import PublishError

CACHES = re.compile(r"(HF|HUGGINGFACE|TRANSFORMERS)(_\w+)?_(CACHE|PATH|OFFLINE)", re.ASCII)
"""The names of environment variables that move the caches of the Hub's clients."""

PATIENCE = 180.0
"""Seconds without another config or split after which a verification fails.

The clients themselves retry failing calls, such as those without an answer, for many minutes.
"""
ROWS_COMPARED = 500
"""The maximum number of rows compared per split, about two row groups of a shard."""

PREFIX = "labyrinth-verify-"
"""The beginning of the names of temporary folders."""


def loaded(
    repo_id: str, repo_type: str, folder: Path, commit: str, patience: float = PATIENCE
) -> str:
    """Load a part of a release in another process, and return what has been loaded.

    Raises:
        PublishError: The Hub returns something else than was published, or nothing.
    """
    has_datasets = repo_type == "dataset" and bool(front_matter.finished(folder))
    if not has_datasets and not (folder / PolicySpec.WEIGHTS).exists():
        return ""
    command = [sys.executable, "-m", "pipeline.release.verify", repo_id, commit]
    said, since = "", time.monotonic()
    with (
        _scratch() as home,
        progress() as bars,
        subprocess.Popen(
            [*command, str(folder.resolve())],
            env=_environment(home),
            cwd=Path(__file__).parents[2],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
        ) as process,
    ):
        bar = bars.add_task("verify", total=None)
        assert process.stdout is not None
        try:
            watchdog = _watchdog(process, patience)
            for line in process.stdout:
                watchdog.cancel()
                watchdog = _watchdog(process, patience)
                said, since = line.strip() or said, time.monotonic()
                bars.update(bar, description=f"verify {said}")
            process.wait()
        finally:
            watchdog.cancel()
            process.kill()
    if process.returncode and time.monotonic() > since + patience:
        waiting = f"nothing came from the Hub in {patience:g} seconds"
        said = f"{waiting}, waiting for {said or 'its first answer'}"
    if process.returncode:
        raise PublishError(
            f"the verification of {commit[:12]} failed, so it is not tagged: "
            f"{said or f'exit status {process.returncode}'}"
        )
    return said


def _watchdog(process: subprocess.Popen[str], seconds: float) -> threading.Timer:
    """Kill a process after some seconds, unless the timer that is returned is cancelled."""
    timer = threading.Timer(seconds, process.kill)
    timer.start()
    return timer


@contextmanager
def _scratch() -> Iterator[Path]:
    """Yield a temporary folder; remove those that killed processes left.

    A process holds the lock beside its folder, and loses it when it is killed.
    """
    root = Path(tempfile.gettempdir())
    for lock in root.glob(f"{PREFIX}*.lock"):
        with suppress(OSError), LocalFile(lock).locked(wait=False):
            LocalFile(lock.with_suffix("")).remove()
    with (
        tempfile.TemporaryDirectory(prefix=PREFIX) as folder,
        LocalFile(Path(f"{folder}.lock")).locked(),
    ):
        yield Path(folder)


def _environment(home: Path) -> dict[str, str]:
    """Return the environment of a process whose caches are empty."""
    kept = {name: value for name, value in os.environ.items() if not CACHES.fullmatch(name)}
    own = {"HF_HOME": str(home), "HF_TOKEN": get_token() or "", "HF_UPDATE_DOWNLOAD_COUNTS": "0"}
    return kept | own | {"USE_TORCH": "0"}  # Or `datasets` would import torch.


def _tell(what: str) -> None:
    """Print a line, which the parent process shows."""
    print(what, flush=True)  # noqa: T201


def verify(source: str, commit: str | None, folder: Path) -> str:
    """Load a policy, or each config of a dataset; return what has been loaded.

    Args:
        source: The repository on the Hub, or a folder.
        commit: The commit on the Hub.
        folder: The folder that was published.

    Raises:
        DatasetError, WrongAnswerError: The Hub returns something else than was published, or
            nothing.
    """
    if (folder / PolicySpec.WEIGHTS).exists():
        load_policy(source, revision=commit)
        return "the policy loads"
    described = front_matter.described(front_matter.finished(folder))
    configs = [*zip(described["configs"], described["dataset_info"], strict=True)]
    smallest = min(configs, key=lambda each: each[1]["download_size"])
    # All as a stream, of which little is downloaded, and one whole.
    for streaming, each in [(False, smallest), *((True, each) for each in configs)]:
        load = partial(check_config, source, commit, folder, *each, streaming=streaming)
        hub.repeated(partial(_patiently, load, each[0]["config_name"]))
    return "every config loads"


def _patiently(load: Callable[[], None], name: str) -> None:
    """Load a config; turn errors that may pass into one that is retried."""
    from datasets.exceptions import DatasetsError

    try:
        load()
    except (OSError, ValueError, HTTPError, DatasetsError) as error:
        told = f"{name} cannot be loaded: {one_line(error.__cause__ or error)}"
        raise hub.WrongAnswerError(told) from error


def check_config(
    source: str,
    commit: str | None,
    folder: Path,
    config: Mapping[str, Any],
    info: Mapping[str, Any],
    *,
    streaming: bool,
) -> None:
    """Load a config, and compare the first rows of its splits, and their number unless streaming.

    Args:
        source: The repository on the Hub, or a folder.
        commit: The commit on the Hub.
        folder: The folder that was published.
        config: The config in the front matter of the published card.
        info: The `dataset_info` of the config there.
        streaming: Whether to load it as a stream.

    Raises:
        DatasetError: The loaded splits or rows differ from the published ones.
    """
    from datasets import Image, load_dataset

    name = f"{config['config_name']}{', streaming' * streaming}"
    _tell(name)
    splits = load_dataset(source, config["config_name"], revision=commit, streaming=streaming)
    expected = {files["split"]: files["path"] for files in config["data_files"]}
    counts = {split["name"]: split["num_examples"] for split in info["splits"]}
    if splits.keys() != expected.keys():
        names = f"{', '.join(splits)} instead of {', '.join(expected)}"
        raise DatasetError(f"{name}: the splits are {names}")
    for split, pattern in expected.items():
        what, rows = f"{name} {split}", splits[split]
        _tell(what)
        for column, feature in rows.features.items():
            if isinstance(feature, Image):
                rows = rows.cast_column(column, Image(decode=False))
        first = _first_rows(folder, pattern)
        if list(islice(rows, len(first))) != first:
            raise DatasetError(f"{what}: the first rows are not those that were published")
        if not streaming and len(rows) != counts[split]:
            told = f"there are {len(rows)} rows instead of {counts[split]}"
            raise DatasetError(f"{what}: {told}")


def _first_rows(folder: Path, pattern: str) -> list[dict[str, Any]]:
    """Return the first rows of the first file that a pattern of a config matches."""
    with COLUMNS.opened(min(folder.glob(pattern))) as file:
        rows: list[dict[str, Any]] = next(file.iter_batches(ROWS_COMPARED)).to_pylist()
    return rows


def main() -> None:
    """Verify the release that the command line names, and exit with 0 on success, else 1."""
    repo_id, commit, folder = sys.argv[1:]
    end_with_parent(os.getppid())
    hub.prepare_client()
    status = 0
    try:
        _tell(verify(repo_id, commit, Path(folder)))
    except (DatasetError, hub.WrongAnswerError) as error:
        _tell(hub.reason_of(error))
        status = 1
    # Exit at once: pyarrow's threads may abort the interpreter when it ends after streaming
    # (https://github.com/apache/arrow/issues/45214), which would look like a failure.
    os._exit(status)


if __name__ == "__main__":
    main()
