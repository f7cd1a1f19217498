"""Which files of a folder belong to a release of its datasets, and which are the user's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from labyrinth_core.data.datasets import Dataset
from labyrinth_core.data.manifest import ANALYSIS, MANIFEST, TABLE, Manifest
from labyrinth_core.data.storage import file_sha256
from pipeline.inspection import front_matter
from pipeline.inspection.companions import beside, companions
from pipeline.inspection.statistics import read_analysis
from pipeline.machinery.artifact import HASHES, Sums
from pipeline.release.figures import pictures_of

README, CHANGELOG = "README.md", "CHANGELOG.md"
CROISSANT, CITATION = "croissant.json", "CITATION.cff"


def files_of(folder: Path) -> dict[str, Path]:
    """Return the files of a release by their paths on the Hub.

    Args:
        folder: A folder of datasets; or one that holds only the files of the release.

    Raises:
        DatasetError: An analysis is damaged, or another program wrote SHA256SUMS.
    """
    if manifests := front_matter.finished(folder):
        names = _published(Sums.read(folder), manifests)
    else:
        files = (path for path in sorted(folder.rglob("*")) if path.is_file())
        names = [path.relative_to(folder).as_posix() for path in files]
    return {name: folder / name for name in names}


def files_of_companions() -> list[str]:
    """Return the names of the files that stages may leave in a folder about their companions."""
    return [name for kind in companions() for name in kind.file_names]


def _published(own: Sums, manifests: Sequence[Manifest]) -> list[str]:
    """Return the paths in a folder of all files of its finished datasets and their card."""
    names = [README, HASHES, *filter(own.has, _written_by_card(manifests))]
    for manifest in manifests:
        name = manifest.config.name
        analysis = read_analysis(Dataset.at(own.folder / name, manifest))
        names += [f"{name}/{ANALYSIS}"] * bool(analysis)
    return [name for name in [*names, *_data(manifests)] if (own.folder / name).is_file()]


def card_files(data_dir: Path) -> list[str]:
    """Return the paths of the files in a folder that a card reads or writes."""
    manifests = front_matter.finished(data_dir)
    names = [README, HASHES, *_written_by_card(manifests), *_data(manifests)]
    names += [f"{m.config.name}/{name}" for m in manifests for name in (ANALYSIS, HASHES)]
    return [name for name in names if (data_dir / name).is_file()]


def _written_by_card(manifests: Sequence[Manifest]) -> list[str]:
    """Return the paths of the files that only the stage `card` writes."""
    pictures = pictures_of([manifest.config.name for manifest in manifests])
    return [CHANGELOG, CITATION, CROISSANT, *files_of_companions(), *pictures]


def _data(manifests: Sequence[Manifest]) -> Iterator[str]:
    """Yield the paths of the manifests, shards and tables of datasets and of their companions."""
    for manifest in manifests:
        shards = (shard.path for shard in manifest.shards)
        yield from (f"{manifest.config.name}/{name}" for name in (MANIFEST, *shards, TABLE))
        for kind in companions():
            for folder, companion in beside([manifest], kind).items():
                shards = (shard.path for shard in companion.shards)
                yield from (f"{folder}/{name}" for name in (MANIFEST, *shards))


def left_out(data_dir: Path, published: Sequence[str]) -> Iterator[str]:
    """Yield the paths in a folder that are not part of a release, except hidden files."""
    folders = {name.partition("/")[0] for name in published if "/" in name}
    for path in sorted(data_dir.glob("[!.]*")):
        if path.name in folders:
            inside = sorted(each.name for each in path.glob("[!.]*") if each.name != HASHES)
            yield from (f"{path.name}/{n}" for n in inside if f"{path.name}/{n}" not in published)
        elif path.name not in published:
            yield f"{path.name}/" if path.is_dir() else path.name


def write_hashes(own: Sums, manifests: Sequence[Manifest]) -> None:
    """Write SHA256SUMS, after all other files; `own` holds the hashes of the card's files."""
    # The hashes of the shards have just been checked.
    known = {
        f"{manifest.config.name}/{shard.path}": shard.sha256
        for manifest in manifests
        for shard in manifest.shards
    }
    names = [name for name in _published(own, manifests) if name != HASHES]
    digests = [known.get(name) or file_sha256(own.folder / name) for name in names]
    Sums(own.folder, made=frozenset(zip(names, digests, strict=True))).write()
