"""The verification of a release in a process of its own, which is watched.

The clients of the Hub repeat what fails for many minutes, and say nothing meanwhile. So the process
tells how far it is, and is given up once neither a row nor a byte has come for a while.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread

from huggingface_hub import get_token

from pipeline.machinery import front_matter
from pipeline.machinery.console import progress, say
from pipeline.release.plan import DATASET, Kind
from pipeline.release.published import files_of
from pipeline.release.remote import PublishError

CACHES = re.compile(r"(HF|HUGGINGFACE|TRANSFORMERS)(_\w+)?_(CACHE|PATH|OFFLINE)", re.ASCII)
"""The names of environment variables that move the caches of the Hub's clients."""

PATIENCE = 180.0
"""Seconds without a row or a byte after which the Hub is given up.

A call of the client has an end after ten seconds without a byte, and is repeated five times.
"""


def verified(repo_id: str, commit: str, folder: Path, kind: Kind) -> str:
    """Load a release from the Hub with an empty cache, by its commit; return what was verified.

    Args:
        repo_id: The repository.
        commit: The release in it.
        folder: The folder with what was released.
        kind: The kind of the repository.

    Raises:
        PublishError: The Hub gives anything else than was published, or gives nothing.
    """
    say(f"verifying {commit[:12]} from an empty cache ...")
    failed = f"the verification of {commit[:12]} failed, so it is not tagged"
    with tempfile.TemporaryDirectory(prefix="labyrinth-verify-") as home:
        errors = Path(home) / "errors.txt"
        command = [sys.executable, "-m", "pipeline.release.verify", repo_id, commit]
        command += [str(folder.resolve()), kind.name]
        with _started(command, home, errors) as process:
            try:
                said = _watch(process, Path(home), _work(folder, kind))
            except TimeoutError as error:
                raise PublishError(f"{failed}: {error}") from error
        told = errors.read_text(errors="replace").strip().rpartition("\n")[2]
    if process.returncode:
        raise PublishError(f"{failed}: {told or f'it ended with {process.returncode}'}")
    return said


def _work(folder: Path, kind: Kind) -> int:
    """Return how much the process tells that it reads: rows, plain and streaming, or bytes."""
    if kind is DATASET:
        manifests = front_matter.finished(folder)
        return 2 * sum(shard.rows for manifest in manifests for shard in manifest.shards)
    return sum(path.stat().st_size for path in files_of(kind, folder).values())


@contextmanager
def _started(command: list[str], home: str, errors: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a process with empty caches, and end it at the end, if need be by force."""
    with (
        errors.open("w") as stderr,
        subprocess.Popen(
            command,
            env=_environment(home),
            cwd=Path(__file__).parents[2],
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
        ) as process,
    ):
        try:
            yield process
            process.wait()
        finally:
            process.kill()


def _watch(process: subprocess.Popen[str], home: Path, total: int) -> str:
    """Show how far a verification is, and return the last line that it writes.

    Args:
        process: The verification.
        home: The folder of its caches.
        total: How much it tells that it reads.

    Raises:
        TimeoutError: Neither a row nor a byte came in `PATIENCE`.
    """
    lines: SimpleQueue[str | None] = SimpleQueue()
    Thread(target=_pass_on, args=(process.stdout, lines), daemon=True).start()
    what, said, held, last = "its files", "", 0, time.monotonic()
    with progress() as bars:
        bar = bars.add_task("verify", total=total)
        while (line := _next(lines)) is not None:
            size = _bytes_had(home)
            if line or size != held:
                held, last = size, time.monotonic()
            elif time.monotonic() > last + PATIENCE:
                raise TimeoutError(
                    f"nothing came from the Hub in {PATIENCE:g} seconds, waiting for {what}"
                )
            said = line or said
            if "\t" in line:
                read, what = line.split("\t")
                bars.update(bar, completed=int(read))
            bars.update(bar, description=f"verify {what}, {held / 1e6:.1f} MB")
    return said


def _bytes_had(home: Path) -> int:
    """Return the bytes in the caches of files and of rows; elsewhere are logs, which grow."""
    files = (path for name in ("hub", "datasets") for path in (home / name).rglob("*"))
    size = 0
    for path in files:
        with suppress(FileNotFoundError):  # Renamed or removed meanwhile.
            size += path.lstat().st_size
    return size


def _pass_on(output: Iterable[str], lines: SimpleQueue[str | None]) -> None:
    for line in output:
        lines.put(line.rstrip("\n"))
    lines.put(None)


def _next(lines: SimpleQueue[str | None]) -> str | None:
    """Return the next line, an empty one if none comes in a second, None at the end."""
    try:
        return lines.get(timeout=1)
    except Empty:
        return ""


def _environment(home: str) -> dict[str, str]:
    """Return the environment of a process whose caches are empty."""
    kept = {name: value for name, value in os.environ.items() if not CACHES.fullmatch(name)}
    own = {"HF_HOME": home, "HF_TOKEN": get_token() or "", "HF_UPDATE_DOWNLOAD_COUNTS": "0"}
    return kept | own | {"USE_TORCH": "0"}  # `datasets` would import it for nothing.
