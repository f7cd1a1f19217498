"""Which labyrinths came and went between two versions of a release, by the tables of both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from huggingface_hub.errors import RepositoryNotFoundError

from labyrinth_core.data.labyrinth_table import TABLE, labyrinths_of
from labyrinth_core.data.manifest import MANIFEST, Manifest
from labyrinth_core.data.storage import file_sha256
from pipeline.release.remote import Remote

CHANGES = "changes.csv"
"""The name of the file with the ids of all labyrinths that came or went."""

Labyrinths = set[tuple[str, str]]
"""The split and the id of each labyrinth of a config."""


@dataclass(frozen=True)
class Changes:
    """What came and went since another version."""

    since: str
    came: Mapping[str, Labyrinths]
    """Config -> the labyrinths that the other version lacks."""
    went: Mapping[str, Labyrinths]
    """Config -> those that only the other version has."""

    def lines(self) -> list[str]:
        """Return a line of the changelog for each config."""
        return [
            f"- `{config}`: since {self.since} {len(self.came[config]):,} labyrinths came and "
            f"{len(self.went[config]):,} went ({CHANGES})"
            for config in self.came
        ]

    def table(self) -> str:
        """Return them as CSV: config, split and id, and whether the labyrinth came or went."""
        rows = [
            f"{config},{split},{labyrinth},{word}"
            for word, of_configs in (("came", self.came), ("went", self.went))
            for config, labyrinths in of_configs.items()
            for split, labyrinth in sorted(labyrinths)
        ]
        return "\n".join(["config,split,labyrinth_id,change", *rows]) + "\n"


def changes_since(
    remote: Remote, version: str, data_dir: Path, manifests: Sequence[Manifest]
) -> Changes | None:
    """Return what comes and goes with a version, None if the repository has no earlier one.

    Configs whose tables are equal are left out, and so are those of which either has no table.

    Args:
        remote: The repository, there or not.
        version: The version that is to be released.
        data_dir: The folder of the datasets.
        manifests: Their manifests.
    """
    try:
        earlier = {tag: commit for tag, commit in remote.versions().items() if tag != version}
    except RepositoryNotFoundError:
        return None
    since = max(filter(lambda tag: parts(tag) < parts(version), earlier), key=parts, default=None)
    if since is None:
        return None
    tree = remote.tree(earlier[since])
    configs = {path.removesuffix(f"/{MANIFEST}") for path in tree if path.endswith(f"/{MANIFEST}")}
    came, went = {}, {}
    for config in sorted(configs | {manifest.config.name for manifest in manifests}):
        path = f"{config}/{TABLE}"
        here, there = data_dir / path, tree.get(path)
        has_table = here.is_file()
        if there is None and not has_table:
            continue  # Such as the questions about another config.
        in_both = config in configs and here.parent.is_dir()
        if in_both and (not has_table or there in (None, file_sha256(here))):
            continue
        now = labyrinths_of(here) if has_table else set()
        before = labyrinths_of(remote.download(path, earlier[since])) if there else set()
        came[config], went[config] = now - before, before - now
    return Changes(since, came, went)


def parts(version: str) -> list[int]:
    """Return the numbers of a version, by which versions are compared."""
    return [*map(int, version.split("."))]
