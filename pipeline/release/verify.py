"""Verification of a release: `python -m pipeline.release.verify REPO COMMIT FOLDER KIND`.

Runs in a process of its own, so that its empty cache is the only one there is: the client falls
back silently to what it has. Everything is asked for by the commit, and compared with the
manifests, or the files, of the folder that was published.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterable, Mapping
from functools import lru_cache, partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from huggingface_hub import HfApi, hf_hub_download
from huggingface_hub.errors import HTTPError  # type: ignore[attr-defined]

from labyrinth_core.data.columns import Row
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.fingerprint import Fingerprint, decoded_picture_digest
from labyrinth_core.data.labyrinth_table import SPLIT, table_config, table_rows
from labyrinth_core.data.manifest import MANIFEST, Manifest, Shard
from labyrinth_core.data.storage import file_sha256
from labyrinth_core.policies.load import load_policy
from pipeline.machinery import front_matter
from pipeline.machinery.worker import end_with_parent
from pipeline.release.plan import DATASET, KINDS, MODEL, Kind, make_plan
from pipeline.release.published import files_of
from pipeline.release.remote import Remote, repeated

TOLD = 100
"""The number of rows after which it is told how far the verification is."""


def verify(repo_id: str, commit: str, folder: Path, kind: Kind) -> str:
    """Return a line that says what was verified.

    Raises:
        DatasetError: The Hub gives anything else than was published, or does not give it.
    """
    files = files_of(kind, folder)
    try:
        plan = make_plan(kind, files, Remote(HfApi(), repo_id, kind).tree(commit))
    except HTTPError as error:
        raise DatasetError(f"its files cannot be listed: {one_line(error)}") from error
    if not plan.is_done:
        path = [*plan.add, *plan.delete][0]
        raise DatasetError(f"{path} on the Hub is not what was published")
    if kind is not DATASET:
        return _verified_files(repo_id, commit, files, kind)
    rows = 0
    for manifest in front_matter.finished(folder):
        rows += _verified_rows(repo_id, commit, manifest, rows, folder)
    return f"verified {commit[:12]}: {rows:,} rows, plain and streaming, are those published."


def _verified_files(repo_id: str, commit: str, files: Mapping[str, Path], kind: Kind) -> str:
    """Download all files, and load the policy of a model; return what was verified."""
    read = 0
    for name, path in files.items():
        _tell(read, name)
        try:
            there = repeated(partial(_downloaded, repo_id, commit, name, kind))
        except (OSError, HTTPError) as error:
            raise DatasetError(f"{name} cannot be downloaded: {one_line(error)}") from error
        if file_sha256(there) != file_sha256(path):
            raise DatasetError(f"{name} is not the one that was published")
        read += path.stat().st_size
    _tell(read, "what was read")
    if kind is MODEL:
        load_policy(repo_id, revision=commit)
    loads = ", and the policy loads" if kind is MODEL else ""
    return f"verified {commit[:12]}: {len(files)} files are those published{loads}."


def _downloaded(repo_id: str, commit: str, name: str, kind: Kind) -> Path:
    return Path(hf_hub_download(repo_id, name, repo_type=kind.name, revision=commit))


def _tell(read: int, what: str) -> None:
    """Tell the process that watches how many rows, or bytes, were read, and what is read now."""
    print(f"{read}\t{what}", flush=True)  # noqa: T201


def _verified_rows(repo_id: str, commit: str, manifest: Manifest, before: int, folder: Path) -> int:
    """Return the number of rows of a config, loaded again after any fault."""
    from datasets.exceptions import DatasetsError

    faults = (OSError, ValueError, HTTPError, DatasetsError)

    def load() -> int:
        if manifest.labyrinths is not None:
            _tell(before, table_config(manifest.config.name))
            _check_table(repo_id, commit, manifest, folder)
        return _load(repo_id, commit, manifest, before)

    try:
        return repeated(load, faults, lambda _: True)
    except faults as error:
        reason = one_line(error.__cause__ or error)
        raise DatasetError(f"{manifest.config.name} cannot be loaded: {reason}") from error


def _load(repo_id: str, commit: str, manifest: Manifest, before: int) -> int:
    """Load a config in every way, and return the number of its rows, each way counted.

    Args:
        repo_id: The dataset on the Hub.
        commit: The commit to load.
        manifest: The manifest of the config, as it was published.
        before: The number of rows of the configs before it.
    """
    from datasets import Image, load_dataset

    name, rows = manifest.config.name, 0
    _tell(before, name)
    remote = hf_hub_download(repo_id, f"{name}/{MANIFEST}", repo_type="dataset", revision=commit)
    if Manifest.read(Path(remote).parent) != manifest:
        raise DatasetError(f"{name}/{MANIFEST} is not the one that was published")
    for split in manifest.config.splits:
        for streaming in (False, True):
            what = f"{name} {split}{', streaming' if streaming else ''}"
            _tell(before + rows, what)
            dataset = load_dataset(repo_id, name, split=split, revision=commit, streaming=streaming)
            dataset = dataset.cast_column("obs", Image(decode=False))
            rows += _check_rows(dataset, manifest.of(split), what, before + rows)
    return rows


def _check_table(repo_id: str, commit: str | None, manifest: Manifest, folder: Path) -> None:
    """Compare the table of labyrinths of a config, loaded in every way, with that of the folder."""
    from datasets import load_dataset

    name = table_config(manifest.config.name)
    for streaming in (False, True):
        table = load_dataset(repo_id, name, split=SPLIT, revision=commit, streaming=streaming)
        published = table_rows(folder / manifest.config.name, manifest)
        for number, (row, right) in enumerate(zip_longest(table, published)):
            if row != right:
                raise DatasetError(f"{name}: row {number} is not the one that was published")


def _check_rows(rows: Iterable[dict[str, Any]], shards: list[Shard], what: str, before: int) -> int:
    """Compare the fingerprints of rows with those of their shards, and return their number."""
    iterator = iter(rows)
    seen = 0
    for shard in shards:
        fingerprint = Fingerprint()
        for _ in range(shard.rows):
            row = next(iterator, None)
            if row is None:
                raise DatasetError(f"{what}: it ends after {seen} rows")
            fingerprint.update([_row(row)])
            seen += 1
            if seen % TOLD == 0:
                _tell(before + seen, what)
        if fingerprint.hexdigest() != shard.fingerprint:
            raise DatasetError(f"{what}: the rows of {shard.path} are not those published")
    if next(iterator, None) is not None:
        raise DatasetError(f"{what}: there are more than {seen} rows")
    _tell(before + seen, what)
    return seen


def _row(row: dict[str, Any]) -> Row:
    png, path = row["obs"]["bytes"], row["obs"]["path"]
    numbers = row["actions"], row["rewards"], row["episode_starts"]
    return Row(png, path, *numbers, row["info"], _digest(png))


@lru_cache(maxsize=100_000)
def _digest(png: bytes) -> bytes:
    """Return the digest of a picture; each comes at least twice, plain and streaming."""
    from PIL import Image

    with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
        return decoded_picture_digest(np.array(image))


def main() -> None:
    """Verify what the command line names, and end with 0 if all is well, else 1."""
    repo_id, commit, folder, kind = sys.argv[1:]
    end_with_parent(os.getppid())
    status = 0
    try:
        print(verify(repo_id, commit, Path(folder), KINDS[kind]))  # noqa: T201
    except DatasetError as error:
        print(error, file=sys.stderr)  # noqa: T201
        status = 1
    sys.stdout.flush()
    sys.stderr.flush()
    # At once: pyarrow's threads may abort an interpreter that ends after streaming
    # (https://github.com/apache/arrow/issues/45214), as if the verification had failed.
    os._exit(status)


if __name__ == "__main__":
    main()
