"""Find a dataset: the folder that holds it, or what is downloaded of it from the Hub."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from posixpath import normpath

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.manifest import Manifest, readable
from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import AnyPath, folder_at


def local_folder(source: str | Path, config: str, revision: str | None) -> AnyPath | None:
    """Return the folder with a dataset's manifest, or None for an id on the Hub.

    Raises:
        ValueError: A revision is given for a folder, or `source` or `config` has the wrong type.
        DatasetError: The source is neither a folder nor an id, or has no such config.
    """
    if not isinstance(config, str):
        raise ValueError(f"config={config!r}: give a name, such as '5x5'")
    folder = folder_of(source)
    if folder is None:
        return None
    if revision is not None:
        raise ValueError(f"revision={revision}: {source} is a folder, which has no revisions")
    with readable(source):
        has_episodes = _has_episodes(folder / config)
        is_inside = not has_episodes and (folder / Manifest.FILE).is_file()
        held = [] if has_episodes else [*map(str, folder.glob(f"*/{Manifest.FILE}"))]
    if is_inside:
        raise DatasetError(
            f"{source} is the folder of the config {folder.name}: give the folder that "
            f"holds it, {folder.parent}"
        )
    if not has_episodes:
        raise _no_config(source, config, held)
    return folder / config


def folder_of(source: str | Path) -> AnyPath | None:
    """Return the folder that a source of datasets names, or None for an id on the Hub.

    Raises:
        ValueError: The source has the wrong type.
        DatasetError: It is neither a folder nor an id.
    """
    try:
        folder = folder_at(source)
    except TypeError as error:
        allowed = "give a folder, or an id such as user/labyrinth"
        raise ValueError(f"source={source!r:.60}: {allowed}") from error
    except ValueError as error:
        raise DatasetError(str(error)) from error
    with readable(source):
        if folder.is_dir():
            return folder
    from labyrinth_core import hub

    if not hub.ID.fullmatch(str(source)):
        raise DatasetError(f"{source} is neither a folder nor an id such as user/labyrinth")
    return None


@contextmanager
def explained(source: str, revision: str | None) -> Iterator[None]:
    """Turn the errors of the Hub's client into a DatasetError, one line."""
    from huggingface_hub.errors import RevisionNotFoundError

    from labyrinth_core import hub

    try:
        yield
    except DatasetError:
        raise
    except RevisionNotFoundError as error:
        raise DatasetError(_no_revision(source, revision)) from error
    except hub.UNAVAILABLE as error:
        raise DatasetError(
            f"{hub.why_unavailable(source, error)}: {hub.reason_of(error)}"
        ) from error


def download(source: str, config: str, files: Sequence[str], commit: str) -> Path:
    """Download a dataset's manifest and the files that match; return the folder of the config.

    Raises:
        DatasetError: The Hub cannot provide them, or has no such config.
    """
    from huggingface_hub import HfApi

    from labyrinth_core import hub

    def downloaded(names: Iterable[str]) -> Path:
        paths = [normpath(f"{config}/{name}") for name in names]
        return hub.download(source, "dataset", commit, paths) / config

    with explained(source, commit):
        folder = downloaded([Manifest.FILE])
        if not _has_episodes(folder):
            names_on_hub = hub.repeated(
                lambda: HfApi().list_repo_files(source, repo_type="dataset", revision=commit)
            )
            if f"{config}/{Manifest.FILE}" in names_on_hub:
                raise DatasetError(
                    f"{source}: the Hub lists {config}/{Manifest.FILE} but has it not"
                )
            raise _no_config(
                source, config, (path for path in names_on_hub if path.count("/") == 1)
            )
        hub.require_whole(folder / Manifest.FILE)
    if files:
        shards = [shard.path for shard in Manifest.read(folder).shards]
        named = (
            fnmatch.filter(shards, pattern) if "*" in pattern else [pattern] for pattern in files
        )
        with explained(source, commit):
            downloaded([*chain.from_iterable(named)])
    return folder


def _no_revision(source: str, revision: str | None) -> str:
    """Return a message for a revision that a dataset on the Hub lacks, with those that it has."""
    from huggingface_hub import HfApi

    from labyrinth_core import hub

    message = f"{source} has no revision {revision}"
    try:
        refs = hub.repeated(lambda: HfApi().list_repo_refs(source, repo_type="dataset"))
    except hub.UNAVAILABLE:
        return message
    return f"{message}, it has {', '.join(ref.name for ref in (*refs.tags, *refs.branches))}"


def _has_episodes(folder: AnyPath) -> bool:
    return (folder / Manifest.FILE).is_file() and DatasetConfig.NAME.fullmatch(
        folder.name
    ) is not None


def _no_config(source: str | Path, config: str, manifests: Iterable[str]) -> DatasetError:
    names = (path.split("/")[-2] for path in manifests if path.endswith(f"/{Manifest.FILE}"))
    held = sorted(filter(DatasetConfig.NAME.fullmatch, names))
    none = f"no dataset: it has no {Manifest.FILE}, which `push_to_hub` of `datasets` leaves out"
    return DatasetError(f"config={config}: {source} holds {', '.join(held) or none}")
