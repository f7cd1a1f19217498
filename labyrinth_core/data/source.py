"""Where a dataset lies: in a folder, in an object store or on the Hub."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from posixpath import normpath

from labyrinth_core.data.dataset_config import QUESTIONS
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.manifest import MANIFEST
from labyrinth_core.data.storage import AnyPath, folder_at

HUB_ID = re.compile(r"(?!.*(--|\.\.))\w[\w.-]*/\w[\w.-]*", re.ASCII)


def locate(
    source: str | Path, config: str, files: Iterable[str], revision: str | None = None
) -> AnyPath:
    """Return the folder with a dataset's manifest and other files, given by names or patterns.

    Files on the Hub are downloaded to its cache first; `../README.md` is the card of all configs.

    Raises:
        DatasetError: There is no such folder, or the Hub does not provide it.
    """
    return local_folder(source, config, revision) or _download(str(source), config, files, revision)


def local_folder(source: str | Path, config: str, revision: str | None) -> AnyPath | None:
    """Return the folder with a dataset's manifest, None for an id on the Hub.

    Raises:
        ValueError: A revision is given for a folder, or the config is not a text.
        DatasetError: The source is neither a folder nor an id, or has no such config.
    """
    if not isinstance(config, str):
        raise ValueError(f"config={config!r}: give a name, such as '5x5'")
    try:
        folder = folder_at(source)
    except ValueError as error:
        raise DatasetError(str(error)) from error
    if folder.is_dir():
        if revision is not None:
            raise ValueError(f"revision={revision}: {source} is a folder, which has no revisions")
        if not _has_episodes(folder / config):
            if (folder / MANIFEST).is_file():
                raise DatasetError(
                    f"{source} is the folder of the config {folder.name}: give the folder that "
                    f"holds it, {folder.parent}"
                )
            raise _no_config(source, config, map(str, folder.glob(f"*/{MANIFEST}")))
        return folder / config
    if not HUB_ID.fullmatch(str(source)):
        raise DatasetError(f"{source} is neither a folder nor an id such as user/labyrinth")
    return None


def _download(source: str, config: str, files: Iterable[str], revision: str | None) -> Path:
    from huggingface_hub import HfApi, snapshot_download

    from labyrinth_core.data.hub import UNAVAILABLE, limit_silence

    limit_silence()
    patterns = [normpath(f"{config}/{name}") for name in (MANIFEST, *files)]
    try:
        snapshot = snapshot_download(
            source, repo_type="dataset", revision=revision, allow_patterns=patterns
        )
        if _has_episodes(Path(snapshot, config)):
            return Path(snapshot) / config
        there = HfApi().list_repo_files(source, repo_type="dataset", revision=revision)
    except UNAVAILABLE as error:
        raise DatasetError(f"{why_unavailable(source, error)}: {one_line(error)}") from error
    manifests = (path for path in there if re.fullmatch(rf"[^/]+/{MANIFEST}", path))
    raise _no_config(source, config, manifests)


def why_unavailable(source: str, error: Exception) -> str:
    """Return why the Hub's client, or `datasets`, does not provide a dataset, given its error."""
    file = error.filename if isinstance(error, OSError) else None
    if file is not None and not Path(file).resolve().is_relative_to(Path(source).resolve()):
        return f"{source}: the cache of the Hub's client cannot be used (HF_HOME moves it)"
    if Path(source).is_dir():
        return f"{source} cannot be read"
    return f"{source} is no folder (labyrinth-datasets makes one), and not to be had from the Hub"


def _has_episodes(folder: AnyPath) -> bool:
    return (folder / MANIFEST).is_file() and not folder.name.endswith(f"-{QUESTIONS}")


def _no_config(source: str | Path, config: str, manifests: Iterable[str]) -> DatasetError:
    names = (path.split("/")[-2] for path in manifests)
    held = sorted(name for name in names if not name.endswith(f"-{QUESTIONS}"))
    none = f"none: a dataset has a {MANIFEST}, which `push_to_hub` of `datasets` leaves out"
    return DatasetError(f"config={config}: {source} holds {', '.join(held) or none}")
