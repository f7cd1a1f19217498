"""The verification of a release: downloads its commit again, with an empty cache.

The clients of the Hub silently fall back on cached files, so the verification runs in its own
process with its own cache:
`python -m pipeline.release.verify REPO COMMIT FOLDER TYPE`, with the Hub's type of the repository.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from huggingface_hub import get_token, hf_hub_download
from huggingface_hub.errors import HTTPError  # type: ignore[attr-defined]

from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.hub import prepare_client
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.rows import open_shard
from labyrinth_core.data.storage import file_sha256
from labyrinth_core.policies.load import load_policy
from labyrinth_core.policies.spec import WEIGHTS
from pipeline.inspection import front_matter
from pipeline.machinery.console import progress, say
from pipeline.machinery.workers import end_with_parent
from pipeline.release.faults import PublishError, repeated
from pipeline.release.files import files_of

CACHES = re.compile(r"(HF|HUGGINGFACE|TRANSFORMERS)(_\w+)?_(CACHE|PATH|OFFLINE)", re.ASCII)
"""The names of environment variables that move the caches of the Hub's clients."""

PATIENCE = 180.0
"""Seconds without a new byte, file or split after which a verification fails.

The clients themselves retry failing calls, such as those without an answer, for many minutes.
"""
REFRESH = 0.5
"""Seconds between two updates of the progress bar."""

ROWS_COMPARED = 500
"""The maximum number of rows compared per split, about two row groups of a shard."""


def verified(
    repo_id: str, commit: str, folder: Path, repo_type: str, patience: float = PATIENCE
) -> str:
    """Verify a release in a process with an empty cache, and return the line to print.

    Raises:
        PublishError: The Hub returns something else than was published, or nothing.
    """
    say(f"verifying {commit[:12]} from an empty cache ...")
    failed = f"the verification of {commit[:12]} failed, so it is not tagged"
    command = [sys.executable, "-m", "pipeline.release.verify", repo_id, commit]
    command += [str(folder.resolve()), repo_type]
    total = sum(path.stat().st_size for path in files_of(folder).values())
    with tempfile.TemporaryDirectory(prefix="labyrinth-verify-") as place:
        output, home = Path(place, "output.txt"), Path(place, "home")
        with (
            output.open("w") as file,
            subprocess.Popen(
                command,
                env=_environment(home),
                cwd=Path(__file__).parents[2],
                stdout=file,
                stderr=subprocess.STDOUT,
            ) as process,
        ):
            try:
                _watch(process, output, home, total, patience)
            except TimeoutError as error:
                raise PublishError(f"{failed}: {error}") from error
            finally:
                process.kill()
        said = _last_line(output)
    if process.returncode:
        raise PublishError(f"{failed}: {said or f'exit status {process.returncode}'}")
    return said


def _watch(
    process: subprocess.Popen[bytes], output: Path, home: Path, total: int, patience: float
) -> None:
    """Show the bytes downloaded and the current file or split until a verification ends.

    Raises:
        TimeoutError: Nothing has changed for `patience` seconds.
    """
    seen, since = (-1, ""), time.monotonic()
    with progress() as bars:
        bar = bars.add_task("verify", total=total)
        while process.poll() is None:
            size, what = now = _bytes_in(home), _last_line(output)
            if now != seen:
                seen, since = now, time.monotonic()
            elif time.monotonic() > since + patience:
                waiting = f"nothing came from the Hub in {patience:g} seconds"
                raise TimeoutError(f"{waiting}, waiting for {what}")
            bars.update(bar, completed=min(size, total), description=f"verify {what}")
            with suppress(subprocess.TimeoutExpired):
                process.wait(REFRESH)
        if process.returncode == 0:
            bars.update(bar, completed=total, description="verify")


def _last_line(output: Path) -> str:
    return output.read_text(errors="replace").strip().rpartition("\n")[2]


def _bytes_in(folder: Path) -> int:
    size = 0
    for place, _, names in os.walk(folder):  # It skips a folder that was deleted meanwhile.
        for name in names:
            with suppress(FileNotFoundError):
                size += Path(place, name).lstat().st_size
    return size


def _environment(home: Path) -> dict[str, str]:
    """Return the environment of a process whose caches are empty."""
    kept = {name: value for name, value in os.environ.items() if not CACHES.fullmatch(name)}
    own = {"HF_HOME": str(home), "HF_TOKEN": get_token() or "", "HF_UPDATE_DOWNLOAD_COUNTS": "0"}
    return kept | own | {"USE_TORCH": "0"}  # Or `datasets` would import torch.


def verify(repo_id: str, commit: str, folder: Path, repo_type: str) -> str:
    """Compare a commit with a folder, file by file, and load it; return what was verified.

    Raises:
        DatasetError: The Hub returns something else than was published, or nothing.
    """
    files = files_of(folder)
    for name, path in files.items():
        _tell(name)
        download = partial(hf_hub_download, repo_id, name, repo_type=repo_type, revision=commit)
        try:
            there = Path(repeated(download))
        except (OSError, HTTPError) as error:
            raise DatasetError(f"{name} cannot be downloaded: {one_line(error)}") from error
        if file_sha256(there) != file_sha256(path):
            raise DatasetError(f"{name} is not the one that was published")
    told = f"verified {commit[:12]}: {len(files)} files are those published"
    if manifests := front_matter.finished(folder):
        from datasets.exceptions import DatasetsError

        faults = (OSError, ValueError, HTTPError, DatasetsError)
        for manifest in manifests:
            check = partial(check_config, repo_id, commit, manifest, folder)
            try:
                repeated(check, faults, lambda _: True)
            except faults as error:
                reason = one_line(error.__cause__ or error)
                raise DatasetError(f"{manifest.config.name} cannot be loaded: {reason}") from error
        return f"{told}, and every config loads, plain and streaming."
    if WEIGHTS in files:
        load_policy(repo_id, revision=commit)
        return f"{told}, and the policy loads."
    return f"{told}."


def _tell(what: str) -> None:
    """Print a line, which `_watch` in the parent process shows."""
    print(what, flush=True)  # noqa: T201


def check_config(source: str, commit: str | None, manifest: Manifest, folder: Path) -> None:
    """Load a config, its table of labyrinths and its companions, and compare the first rows.

    Args:
        source: The dataset on the Hub, or a folder.
        commit: The commit of a dataset on the Hub.
        manifest: The published manifest of the config.
        folder: The published folder of datasets.

    Raises:
        DatasetError: The loaded splits or rows differ from the published ones.
    """
    from datasets import Image, load_dataset

    described = front_matter.described([manifest])
    for config, info in zip(described["configs"], described["dataset_info"], strict=True):
        name = config["config_name"]
        counts = {split["name"]: split["num_examples"] for split in info["splits"]}
        expected = {
            files["split"]: _first_rows(folder, files["path"]) for files in config["data_files"]
        }
        for mode in ("", ", streaming"):
            _tell(f"{name}{mode}")
            splits = load_dataset(source, name, revision=commit, streaming=bool(mode))
            if splits.keys() != expected.keys():
                names = f"{', '.join(splits)} instead of {', '.join(expected)}"
                raise DatasetError(f"{name}{mode}: the splits are {names}")
            for split, first in expected.items():
                what, loaded = f"{name} {split}{mode}", splits[split]
                _tell(what)
                for column, feature in loaded.features.items():
                    if isinstance(feature, Image):
                        loaded = loaded.cast_column(column, Image(decode=False))
                if list(islice(loaded, len(first))) != first:
                    raise DatasetError(f"{what}: the first rows are not those that were published")
                if not mode and len(loaded) != counts[split]:
                    told = f"there are {len(loaded)} rows instead of {counts[split]}"
                    raise DatasetError(f"{what}: {told}")


def _first_rows(folder: Path, pattern: str) -> list[dict[str, Any]]:
    """Return the first rows of the first file that a pattern of a config matches."""
    with open_shard(min(folder.glob(pattern))) as file:
        rows: list[dict[str, Any]] = next(file.iter_batches(ROWS_COMPARED)).to_pylist()
    return rows


def main() -> None:
    """Verify the release that the command line names, and exit with 0 on success, else 1."""
    repo_id, commit, folder, repo_type = sys.argv[1:]
    end_with_parent(os.getppid())
    prepare_client()
    status = 0
    try:
        _tell(verify(repo_id, commit, Path(folder), repo_type))
    except DatasetError as error:
        _tell(str(error))
        status = 1
    # Exit at once: pyarrow's threads may abort the interpreter when it ends after streaming
    # (https://github.com/apache/arrow/issues/45214), which would look like a failure.
    os._exit(status)


if __name__ == "__main__":
    main()
