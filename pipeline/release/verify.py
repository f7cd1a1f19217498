"""Verification of a release: `python -m pipeline.release.verify REPO COMMIT FOLDER`.

Runs in a process of its own, so that its empty cache is the only one there is: the client falls
back silently to what it has. Everything is asked for by the commit, and compared with the
manifests of the folder that was published.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.manifest import (
    MANIFEST,
    DatasetError,
    Fingerprint,
    Manifest,
    Shard,
    decoded_picture_digest,
)
from pipeline.schema import SPLITS, Row


def verify(repo_id: str, commit: str, folder: Path) -> str:
    """Return a line that says what was verified.

    Raises:
        DatasetError: The Hub gives anything else than was published.
    """
    from datasets import Image, load_dataset
    from huggingface_hub import HfApi, hf_hub_download

    tree = {
        entry.path: entry
        for entry in HfApi().list_repo_tree(
            repo_id, repo_type="dataset", revision=commit, recursive=True
        )
    }
    rows = 0
    for path in sorted(folder.glob(f"*/{MANIFEST}")):
        manifest = Manifest.read(path.parent)
        name = manifest.config.name
        remote = hf_hub_download(
            repo_id, f"{name}/{MANIFEST}", repo_type="dataset", revision=commit
        )
        if Manifest.read(Path(remote).parent) != manifest:
            raise DatasetError(f"{name}/{MANIFEST} is not the one that was published")
        for shard in manifest.shards:
            _check_entry(tree, f"{name}/{shard.path}", shard)
        for split in SPLITS:
            for streaming in (False, True):
                dataset = load_dataset(
                    repo_id, name, split=split, revision=commit, streaming=streaming
                )
                dataset = dataset.cast_column("obs", Image(decode=False))
                what = f"{name} {split}{', streaming' if streaming else ''}"
                rows += _check_rows(dataset, manifest.of(split), what)
    return f"verified {commit[:12]}: {rows:,} rows, plain and streaming, are those published."


def _check_entry(tree: dict[str, Any], path: str, shard: Shard) -> None:
    entry = tree.get(path)
    lfs = getattr(entry, "lfs", None)
    if entry is None:
        raise DatasetError(f"{path} is missing")
    if lfs is not None and lfs.sha256 != shard.sha256:
        raise DatasetError(f"{path} has the sha256 {lfs.sha256}, not {shard.sha256}")


def _check_rows(rows: Iterable[dict[str, Any]], shards: list[Shard], what: str) -> int:
    """Compare the fingerprints of rows with those of their shards, and return their number."""
    iterator = iter(rows)
    seen = 0
    for shard in shards:
        fingerprint = Fingerprint()
        for _ in range(shard.rows):
            row = next(iterator, None)
            if row is None:
                raise DatasetError(f"{what}: it ends after {seen} rows")
            fingerprint.update(_row(row))
            seen += 1
        if fingerprint.hexdigest() != shard.fingerprint:
            raise DatasetError(f"{what}: the rows of {shard.path} are not those published")
    if next(iterator, None) is not None:
        raise DatasetError(f"{what}: there are more than {seen} rows")
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


if __name__ == "__main__":
    repo, commit, folder = sys.argv[1:]
    try:
        sys.stdout.write(verify(repo, commit, Path(folder)) + "\n")
    except DatasetError as error:
        sys.exit(str(error))
