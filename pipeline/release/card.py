"""The card of a folder of datasets: README.md, Croissant, pictures, citation, changelog, hashes.

Its numbers are the counts of the datasets and what the stage `analyse` has found out about them;
the same data give the same bytes.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.labyrinth_table import TABLE, table_file
from labyrinth_core.data.manifest import ANALYSIS, MANIFEST, Manifest
from labyrinth_core.data.storage import AnyPath, file_sha256, write_text
from pipeline.config.run import Run
from pipeline.machinery import front_matter
from pipeline.machinery.console import say
from pipeline.machinery.counts import COUNTS
from pipeline.machinery.locks import held
from pipeline.machinery.statistics import DatasetStatistics, statistics_of
from pipeline.release import readme
from pipeline.release.changelog import updated
from pipeline.release.citation import citation_file
from pipeline.release.croissant import croissant
from pipeline.release.figures import FIGURES, banner
from pipeline.release.provenance import ARXIV, Release

HASHES = "SHA256SUMS"

TASK_CATEGORIES = ["reinforcement-learning"]
"""Tasks of the Hub's list, https://huggingface.co/tasks."""
TAGS = [
    "imitation-learning",
    "generalization",
    "labyrinth",
    "maze",
    "gymnasium",
    "synthetic",
    f"arxiv:{ARXIV}",
]
"""The last one makes the Hub link the paper."""

_BOUNDS = ("1K", "10K", "100K", "1M", "10M", "100M", "1B", "10B", "100B", "1T")
"""The bounds of the Hub's size categories: thousand, ten thousand and so on."""


def run(run: Run) -> None:
    """Write the card of the data_dir of a run.

    Raises:
        DatasetError: There is no dataset, one is damaged, or the README.md is somebody else's.
        OSError: The folder cannot be written.
    """
    datasets = write_card(run.data_dir, workers=run.options.workers)
    rows = sum(dataset.rows for dataset in datasets)
    names = ", ".join(dataset.name for dataset in datasets)
    say(
        f"{run.data_dir / 'README.md'} describes {names}: {rows:,} rows, no structure in two "
        f"splits; with croissant.json, {HASHES} and {readme.PICTURES}."
    )


def write_card(
    data_dir: AnyPath,
    repo_id: str | None = None,
    version: str | None = None,
    *,
    workers: int = 1,
) -> list[DatasetStatistics]:
    """Write the card of all finished datasets of a folder, and return their statistics.

    A process that writes the README.md at the same time, such as a build of another size, waits or
    is waited for, since one of the two would not know of the other's dataset.

    Args:
        data_dir: The folder.
        repo_id: The id of the dataset on the Hub, such as `user/labyrinth`, if it is known.
        version: The version of the release, if it is one.
        workers: The number of processes that read shards.

    Raises:
        DatasetError: There is no dataset, one is damaged, two splits of one share a structure,
            or the README.md is somebody else's.
        OSError: The folder cannot be written.
    """
    with held(data_dir, "README.md"):
        return _write_card(data_dir, Release(repo_id, version), workers)


def _write_card(data_dir: AnyPath, release: Release, workers: int) -> list[DatasetStatistics]:
    values, text = front_matter.read(data_dir / "README.md")
    datasets = statistics_of(data_dir, "card", workers)
    for dataset in datasets:
        if problems := "; ".join(dataset.counts.certificate.problems()):
            reason = f"{problems}: no card for such a dataset"
            raise DatasetError(f"{data_dir / dataset.name}: {reason}")
        if dataset.manifest.labyrinths is not None:
            with table_file(data_dir / dataset.name, dataset.manifest):
                pass  # It is not damaged.
    manifests = [dataset.manifest for dataset in datasets]
    default = front_matter.default_config(manifests)
    text = front_matter.with_generated(text, readme.text(datasets, default, release))
    texts = {
        "croissant.json": croissant(datasets, release),
        "CITATION.cff": citation_file(release),
        "CHANGELOG.md": updated(_changelog(data_dir / "CHANGELOG.md"), manifests, release.version),
        "README.md": _with_front_matter(values, manifests, text),
    }
    _draw(data_dir, datasets, default)
    for dataset in datasets:
        dataset.counts.write(data_dir / dataset.name, dataset.manifest)
    for name, content in texts.items():
        write_text(data_dir / name, content)
    _write_hashes(data_dir, manifests)
    return datasets


def _draw(data_dir: AnyPath, datasets: Sequence[DatasetStatistics], default: str) -> None:
    """Draw all pictures, and remove those of configs that are gone."""
    folder = data_dir / readme.PICTURES
    folder.mkdir(exist_ok=True)
    shown = next(dataset for dataset in datasets if dataset.name == default)
    banner(shown.splits).save(data_dir / readme.BANNER)
    drawn = set()
    for dataset in datasets:
        for name, figure in FIGURES.items():
            path = data_dir / readme.picture_path(dataset.name, name)
            figure.draw(dataset.splits).save(path)
            drawn.add(path)
    ours = re.compile(rf"\d+x\d+(-\w+)?-({'|'.join(FIGURES)})\.png", re.ASCII)
    for path in folder.iterdir():
        if path not in drawn and ours.fullmatch(path.name):
            path.unlink()


def _changelog(path: AnyPath) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return ""
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path} is not UTF-8 text: move it away") from error


def _with_front_matter(values: dict[str, Any], manifests: list[Manifest], text: str) -> str:
    """Return the whole README.md; keys that a person added, and added tags, are kept."""
    rows = sum(shard.rows for manifest in manifests for shard in manifest.shards)
    own = {
        "license": "mit",
        "pretty_name": values.get("pretty_name", "Labyrinth"),
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
    """Return the Hub's word for a number of rows (`huggingface_hub.DatasetCardData`)."""
    words = ["n<1K", *(f"{low}<n<{high}" for low, high in pairwise(_BOUNDS)), "n>1T"]
    return words[min(max(len(str(rows)) - 3, 0), len(_BOUNDS))]


def published_files(data_dir: AnyPath, manifests: Sequence[Manifest]) -> list[str]:
    """Return the paths in a folder of all files of its finished datasets and their card."""
    names = ["README.md", "CHANGELOG.md", "CITATION.cff", "croissant.json", HASHES]
    pictures = (data_dir / readme.PICTURES).glob("[!.]*.png")
    names += [f"{readme.PICTURES}/{path.name}" for path in pictures]
    for manifest in manifests:
        files = [MANIFEST, COUNTS, ANALYSIS, *(shard.path for shard in manifest.shards)]
        files += [TABLE] * (manifest.labyrinths is not None)
        names += [f"{manifest.config.name}/{name}" for name in files]
    return [name for name in names if (data_dir / name).is_file()]


def _write_hashes(data_dir: AnyPath, manifests: Sequence[Manifest]) -> None:
    # Those of the shards have just been checked.
    known = {
        f"{manifest.config.name}/{shard.path}": shard.sha256
        for manifest in manifests
        for shard in manifest.shards
    }
    hashes = {
        name: known.get(name) or file_sha256(data_dir / name)
        for name in published_files(data_dir, manifests)
        if name != HASHES
    }
    lines = [f"{digest}  {name}\n" for name, digest in sorted(hashes.items())]
    write_text(data_dir / HASHES, "".join(lines))
