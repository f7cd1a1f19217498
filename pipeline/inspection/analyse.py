"""The stage `analyse`: leakage and shift between the splits of a dataset.

It writes `analysis.json` in the dataset's folder.
"""

from __future__ import annotations

from collections.abc import Iterator

from labyrinth_core.data import SPLITS, Dataset, Manifest
from pipeline.config import Job, WorkOptions
from pipeline.inspection.counts import Content
from pipeline.inspection.leakage import find_leakage
from pipeline.inspection.shift import PERMUTATIONS, compare
from pipeline.inspection.statistics import DatasetStatistics, count_dataset
from pipeline.inspection.verdict import as_text, leaks
from pipeline.machinery import leave, say


def run(job: Job[WorkOptions]) -> None:
    """Analyse the dataset of a job.

    Raises:
        DatasetError: The dataset is missing or damaged.
        OSError: The result cannot be written.
    """
    for line in _analyse(job):
        say(line)


def _analyse(job: Job[WorkOptions]) -> Iterator[str]:
    """Analyse a dataset, leave the result in its folder, and yield the lines to print."""
    data = Dataset.at(job.folder)
    manifest = data.manifest
    statistics, contents = read_contents(data, job.options.workers)
    labyrinths = {split: content.labyrinths for split, content in contents.items()}
    leakage = find_leakage(labyrinths, statistics.certificate)
    pairs = [("train", split) for split in SPLITS.base[1:]] + [("validation", "test")]
    shifts = compare(contents, pairs, manifest.config.seed)
    for shift in manifest.config.shifts:  # Each has its own question, and its own family of tests.
        pairs = [(SPLITS[shift].parent or "test", shift)]
        shifts += compare(contents, pairs, manifest.config.seed)
    content = {
        "name": manifest.config.name,
        "fingerprint": manifest.fingerprint,
        "leakage": leakage.to_json(),
        "shift": {
            "permutations": PERMUTATIONS,
            "measures": [shift.to_json() for shift in shifts],
        },
    }
    text = as_text(content).encode()
    leave(job.folder, {Manifest.ANALYSIS: text}, overwrite=job.options.overwrite)
    yield from leaks(leakage, {})
    yield f"Wrote {job.folder / Manifest.ANALYSIS} (near-duplicates, tests of shift)."


def read_contents(data: Dataset, workers: int = 1) -> tuple[DatasetStatistics, dict[str, Content]]:
    """Return the counts of a dataset and the content of each split, under a progress bar.

    Raises:
        DatasetError: A shard is missing or damaged, or differs from the manifest.
    """
    parts: dict[str, list[Content]] = {}
    statistics = count_dataset(
        data,
        workers,
        "analyse",
        keep=lambda split, content: parts.setdefault(split, []).append(content),
    )
    return statistics, {split: Content.joined(of_split) for split, of_split in parts.items()}
