"""The card of a folder of datasets: README.md, Croissant, pictures, citation, changelog.

Its numbers are the counts of the datasets and the results of the stage `analyse`; the same data
give the same bytes.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import yaml

from labyrinth_core.data import Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import AnyPath, File
from labyrinth_core.version import DEVELOPERS, __version__
from pipeline.config import Job, WorkOptions
from pipeline.inspection import Companion, DatasetStatistics, front_matter, statistics_of
from pipeline.machinery import Ownership, Sums, held, say
from pipeline.release import readme
from pipeline.release.croissant import croissant
from pipeline.release.figures import BANNER, FIGURES, PICTURES, banner, picture_path
from pipeline.release.texts import Release, fill, read

README, CHANGELOG = "README.md", "CHANGELOG.md"
CROISSANT, CITATION = "croissant.json", "CITATION.cff"

NAME = "Labyrinth"
"""The name of the dataset, unless its card has another."""
TASK_CATEGORIES = ["reinforcement-learning"]
"""Tasks of the Hub's list, https://huggingface.co/tasks."""
TAGS = [
    "imitation-learning",
    "generalization",
    "labyrinth",
    "maze",
    "gymnasium",
    "synthetic",
    "arxiv:2509.24784",
]
"""The last one makes the Hub link the paper."""

ORIGIN = {
    "language": ["en"],
    "annotations_creators": ["machine-generated"],
    "source_datasets": ["original"],
}
"""Where the data are from, in the Hub's words (`huggingface_hub.DatasetCardData`); English is the
language of the settings in `info`. Other values in a card are kept."""

UNRELEASED = "Unreleased"
"""The heading in CHANGELOG.md of data that no version has yet."""

_BOUNDS = ("1K", "10K", "100K", "1M", "10M", "100M", "1B", "10B", "100B", "1T")
"""The bounds of the Hub's size categories: thousand, ten thousand and so on."""


def run(job: Job[WorkOptions]) -> None:
    """Write the card of the data_dir of a run.

    Raises:
        DatasetError: As for `write_card`.
        OSError: The folder cannot be written.
    """
    options = job.options
    datasets = write_card(job.data_dir, workers=options.workers, overwrite=options.overwrite)
    say(f"{job.data_dir / README} describes {', '.join(dataset.name for dataset in datasets)}.")


@dataclass(frozen=True)
class Card:
    """The card of a folder of datasets, ready to be written."""

    datasets: list[DatasetStatistics]
    files: Mapping[str, bytes]
    """The files of the card, but SHA256SUMS."""
    sums: Sums
    """The list of all files that a release of the folder has."""
    own: Sums
    """The list that is there."""
    others: list[str]
    """The files of a user under names of the card, which are not replaced."""

    def write(self) -> None:
        """Write the card; SHA256SUMS comes last.

        Raises:
            DatasetError, OSError: The folder has a link in the place of a folder of ours, or cannot
                be written.
        """
        drawn = [name for name, _ in self.own.hashes if name.startswith(f"{PICTURES}/")]
        of_companions = [name for kind in Companion.kinds() for name in kind.file_names]
        gone = [name for name in (*drawn, *of_companions) if name not in self.files]
        Ownership(self.own).replace(self.files, gone=gone)
        self.sums.write()
        if self.others:
            reason = "because no card wrote them, or they were damaged or changed since"
            names = ", ".join(self.others)
            say(f"Not written, {reason}; overwrite=true replaces them: {names}.")


def write_card(
    data_dir: AnyPath, release: Release | None = None, *, workers: int = 1, overwrite: bool = False
) -> list[DatasetStatistics]:
    """Write the card of all finished datasets of a folder, and return their statistics.

    The arguments and errors are those of `prepared_card`.
    """
    with prepared_card(data_dir, release, workers=workers, overwrite=overwrite) as card:
        card.write()
    return card.datasets


@contextmanager
def prepared_card(
    data_dir: AnyPath,
    release: Release | None = None,
    *,
    workers: int = 1,
    overwrite: bool = False,
    alone: bool = True,
) -> Iterator[Card]:
    """Yield the card of all finished datasets of a folder, after checking them.

    Args:
        data_dir: The folder.
        release: The release, if the card is for one.
        workers: The number of processes that read shards.
        overwrite: Whether to replace files that no card wrote, or that changed since.
        alone: Whether other processes that write the README.md, such as a build of another size,
            wait until the context ends, or one of them would miss the other's dataset.

    Raises:
        DatasetError: There is no dataset, one is damaged, two splits of one share a structure,
            or the README.md or SHA256SUMS is not ours or damaged.
    """
    with held(data_dir, README) if alone else nullcontext():
        values, text = front_matter.read(data_dir / README)
        own = Sums.read(data_dir, overwrite=overwrite)
        versions = (data_dir / CHANGELOG).read_text(encoding="utf-8") if own.has(CHANGELOG) else ""
        datasets = statistics_of(data_dir, "card", workers)
        for dataset in datasets:
            if problems := "; ".join(dataset.certificate.problems()):
                reason = f"{problems}; no card is written for such a dataset"
                raise DatasetError(f"{data_dir / dataset.name}: {reason}")
            dataset.data.check_table()
        manifests = [dataset.manifest for dataset in datasets]
        default = front_matter.default_config(manifests)
        release = replace(release or Release(), licence=front_matter.licence_of(values))
        text = front_matter.with_generated(text, readme.text(datasets, default, release))
        files = {
            **_pictures(datasets, default),
            CHANGELOG: changelog(versions, manifests, release.version).encode(),
            CROISSANT: croissant(datasets, release).encode(),
            CITATION: _citation_file(release).encode(),
        }
        for kind in Companion.kinds():
            if own_companions := kind.beside(manifests):
                files |= kind.files(own_companions, str(values.get("pretty_name", NAME)))
        others = [] if overwrite else Ownership(own).others(files)
        for name in others:
            del files[name]
        files[README] = _with_front_matter(values, manifests, text).encode()
        listed = _data(data_dir, datasets)
        if release.version and not overwrite:
            _require_as_listed(own, manifests, listed)
        listed |= {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
        yield Card(datasets, files, Sums(data_dir, made=frozenset(listed.items())), own, others)


def _data(data_dir: AnyPath, datasets: Sequence[DatasetStatistics]) -> dict[str, str]:
    """Return the SHA-256 of each manifest, shard, table and analysis, as the manifests give them.

    The hashes of shards and tables have just been checked; what changes later does not match them.
    """
    listed: dict[str, str] = {}
    for dataset in datasets:
        manifest = dataset.manifest
        folders = {dataset.name: manifest}
        for kind in Companion.kinds():
            folders |= kind.beside([manifest])
        for name, each in folders.items():
            listed |= {f"{name}/{shard.path}": shard.sha256 for shard in each.shards}
            listed[f"{name}/{Manifest.FILE}"] = File(data_dir / name / Manifest.FILE).sha256()
        listed[f"{dataset.name}/{Manifest.TABLE}"] = manifest.table.sha256
        if dataset.analysis is not None:
            path = data_dir / dataset.name / Manifest.ANALYSIS
            listed[f"{dataset.name}/{Manifest.ANALYSIS}"] = File(path).sha256()
    return listed


def _require_as_listed(own: Sums, manifests: Sequence[Manifest], listed: Mapping[str, str]) -> None:
    """Raise DatasetError for a manifest that was changed, while its shards are those listed."""
    for name in (manifest.config.name for manifest in manifests):
        of_config = {each: digest for each, digest in listed.items() if each.startswith(f"{name}/")}
        changed = [each for each in of_config.items() if each not in own.hashes]
        names = {each for each, _ in own.hashes}
        if [each for each, _ in changed] == [f"{name}/{Manifest.FILE}"] and changed[0][0] in names:
            raise DatasetError(
                f"{own.folder / name / Manifest.FILE} has changed, though its shards have not: "
                "build the dataset again, or give overwrite=true to publish it as it is"
            )


def _pictures(datasets: Sequence[DatasetStatistics], default: str) -> dict[str, bytes]:
    """Return all pictures by their paths."""
    shown = next(dataset for dataset in datasets if dataset.name == default)
    drawn = {BANNER: banner(shown.splits).png()}
    for dataset in datasets:
        for name, figure in FIGURES.items():
            drawn[picture_path(dataset.name, name)] = figure.draw(dataset.splits).png()
    return drawn


def _with_front_matter(values: dict[str, Any], manifests: list[Manifest], text: str) -> str:
    """Return the whole README.md; keys that a person added, and added tags, are kept."""
    rows = sum(shard.rows for manifest in manifests for shard in manifest.shards)
    own = {
        "license": values.get("license") or front_matter.LICENCE,
        "pretty_name": values.get("pretty_name", NAME),
        **{key: values.get(key, value) for key, value in ORIGIN.items()},
        "task_categories": _joined(TASK_CATEGORIES, values.get("task_categories")),
        "tags": _joined(TAGS, values.get("tags")),
        "size_categories": [size_category(rows)],
        **front_matter.described(manifests),
    }
    kept = {key: value for key, value in values.items() if key not in own}
    return front_matter.with_values(own | kept, text)


def _joined(ours: list[str], theirs: Any) -> list[str]:
    added = [theirs] if isinstance(theirs, str) else theirs if isinstance(theirs, list) else []
    return list(dict.fromkeys([*ours, *map(str, added)]))


def size_category(rows: int) -> str:
    """Return the Hub's size category for a number of rows (`huggingface_hub.DatasetCardData`)."""
    words = ["n<1K", *(f"{low}<n<{high}" for low, high in pairwise(_BOUNDS)), "n>1T"]
    return words[min(max(len(str(rows)) - 3, 0), len(_BOUNDS))]


def _citation_file(release: Release) -> str:
    """Return the CITATION.cff of a dataset (https://citation-file-format.github.io, 1.2.0)."""
    fields = {"version": release.version or "", "url": release.url, "software": __version__}
    values = yaml.safe_load(fill("CITATION.cff", developers=DEVELOPERS, **fields))
    if release.licence != front_matter.LICENCE:  # Its SPDX name is unknown, only the Hub's.
        del values["license"], values["license-url"]
    if not release.repo_id:
        del values["url"]
    values = {name: value for name, value in values.items() if value is not None}
    return yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=100)


def changelog(text: str, manifests: Sequence[Manifest], version: str | None) -> str:
    """Return the changelog with an entry for the datasets of a folder.

    The entry "Unreleased" changes with the data, and becomes the entry of the next version.

    Args:
        text: The changelog so far; empty if there is no file.
        manifests: The manifests of all datasets of the folder.
        version: The version of the release, if it is one.
    """
    title, *parts = re.split(r"^## ", text, flags=re.MULTILINE)
    entries = {heading: body.strip() for heading, _, body in (p.partition("\n") for p in parts)}
    lines = "\n".join(
        f"- `{manifest.config.name}`: {sum(shard.rows for shard in manifest.shards):,} rows, "
        f"fingerprint `{manifest.fingerprint}`"
        for manifest in manifests
    )
    if version is None and lines == next(iter(entries.values()), ""):
        return text
    heading = version or UNRELEASED
    older = {name: body for name, body in entries.items() if name not in (heading, UNRELEASED)}
    written = (f"## {name}\n\n{body}" for name, body in {heading: lines, **older}.items())
    return "\n\n".join([title.strip() or read("changelog.md").strip(), *written]) + "\n"
