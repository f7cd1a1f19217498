"""The plan of a release: which files on the Hub it changes, found by comparing hashes.

Repositories are of five kinds: datasets, exports in two formats, models (policies), environments.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from huggingface_hub.utils.sha import git_hash

from labyrinth_core.data.storage import file_sha256
from pipeline.config.export import CODEBASE_VERSION


@dataclass(frozen=True)
class Kind:
    """A kind of repository, and which files a release has in it."""

    name: str
    """The name of the kind; for an export, the name of the library."""
    repo_type: Literal["dataset", "model"]
    """The Hub's type of the repository."""
    data: str
    """A regular expression for the paths of data, not of the files that describe it."""
    listed: str
    """A regular expression that some path in every release's SHA256SUMS matches."""
    newest_tag: str | None = None
    """A tag, beside the one of each version, that moves to the newest release on `main`."""

    def is_data(self, path: str) -> bool:
        """Return whether a path is data, and not part of the card."""
        return re.fullmatch(self.data, path, re.ASCII) is not None


DATASET = Kind(
    "dataset",
    "dataset",
    data=r"\d+x\d+(-\w+){0,2}/(manifest\.json|labyrinths\.parquet|\w+-\d{5,}-of-\d{5,}\.parquet)",
    listed=r"[^/]+/manifest\.json|pictures/[^/]+\.png",
)
LEROBOT = Kind(
    "LeRobot", "dataset", r"(data|meta)/.+", r"meta/info\.json", newest_tag=CODEBASE_VERSION
)
MINARI = Kind("Minari", "dataset", r"[^/]+/[^/]+/data/.+", r"namespace_metadata\.json")
MODEL = Kind(
    "model", "model", data=r"config\.json|model\.safetensors", listed=r"model\.safetensors"
)
ENVIRONMENT = Kind("environment", "model", data=r"env\.py", listed=r"env\.py")
KINDS: dict[str, Kind] = {
    kind.name: kind for kind in (DATASET, LEROBOT, MINARI, MODEL, ENVIRONMENT)
}


@dataclass(frozen=True)
class Plan:
    """The changes that a release would make."""

    kind: Kind
    files: Mapping[str, Path]
    """All files of the release, by their path on the Hub."""
    add: list[str]
    keep: list[str]
    delete: list[str]
    others: list[str] = field(default_factory=list)
    """Paths in `add` where the Hub holds a file that no release wrote."""

    @property
    def bytes(self) -> int:
        """The number of bytes to send."""
        return sum(self.files[path].stat().st_size for path in self.add)

    @property
    def is_done(self) -> bool:
        """Whether the Hub holds exactly these files already."""
        return not self.add and not self.delete

    @property
    def data(self) -> list[str]:
        """The paths to add or delete that are data."""
        return [path for path in [*self.add, *self.delete] if self.kind.is_data(path)]


def make_plan(
    kind: Kind,
    files: Mapping[str, Path],
    remote: Mapping[str, str],
    released: Callable[[Mapping[str, str]], Collection[str]] = lambda _: (),
) -> Plan:
    """Return what to change so that the Hub holds these files.

    Args:
        kind: The kind of the repository.
        files: The local files by their path on the Hub.
        remote: The files on the Hub now, as from `Remote.tree`.
        released: Returns which of some of these an earlier release wrote; others are neither
            replaced nor deleted.
    """
    keep = [path for path, local in files.items() if path in remote and _same(local, remote[path])]
    add = [path for path in files if path not in keep]
    others = {path: remote[path] for path in sorted(remote.keys() - set(keep))}
    ours = released(others) if others else ()  # A repository that does not exist is not asked.
    return Plan(
        kind=kind,
        files=files,
        add=add,
        keep=keep,
        delete=[path for path in sorted(ours) if path not in files],
        others=[path for path in add if path in remote and path not in ours],
    )


def _same(local: Path, digest: str) -> bool:
    """Return whether a file has this SHA-256 (64 digits) or this hash of a Git blob."""
    return digest == (file_sha256(local) if len(digest) == 64 else git_hash(local.read_bytes()))
