"""The statistics of a dataset: counts, certificate of disjointness, and analysis.

The card and the report count the shards, and read the `analysis.json` that the stage `analyse`
writes in the dataset's folder.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, TypedDict

from labyrinth_core import typed
from labyrinth_core.data import Dataset, DatasetConfig, Manifest, Shard, ShardFile
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.storage import AnyPath, File
from pipeline.inspection import front_matter
from pipeline.inspection.counts import Content, SplitCounts, count_shard
from pipeline.inspection.leakage import Certificate, Keys, certify
from pipeline.machinery import Sums, ordered_map, tracked

MOST_NAMED = 20
"""The maximum number of shared labyrinths listed per pair of splits and kind."""
KINDS = ("equal", "mirrored", "symmetric", "same_route")
"""The ways in which two labyrinths can match."""

_Split = Annotated[str, typed.Like(r"\w{1,99}")]
_Id = Annotated[str, typed.Like("[0-9a-f]{16}")]
_Within = TypedDict("_Within", {"1": typed.Count, "2": typed.Count, "3": typed.Count})


class _Both(TypedDict):
    first: _Split
    second: _Split


class _Pair(_Both):
    equal: Mapping[_Id, _Id]
    mirrored: Mapping[_Id, _Id]
    symmetric: Mapping[_Id, _Id]
    same_route: Mapping[_Id, _Id]
    within: _Within
    spread: Annotated[str, typed.Like(r"[\w., -]{0,99}")]


class _Measure(_Both):
    measure: Annotated[str, typed.Like(r"\w[\w ]{0,99}")]
    labyrinths: tuple[typed.Count, typed.Count]
    distance: Annotated[float, typed.Within(0)]
    effect: float | None
    p_value: typed.Share
    corrected: typed.Share


class _Leakage(TypedDict):
    labyrinths: Mapping[_Split, typed.Count]
    repeated: Mapping[_Split, typed.Count]
    strangers: Mapping[_Split, list[_Id]]
    pairs: list[_Pair]


class _Shift(TypedDict):
    permutations: typed.Count
    measures: list[_Measure]


class _Analysis(TypedDict):
    """The parts of `analysis.json` that the card and the report use."""

    leakage: _Leakage
    shift: _Shift


class _Made(TypedDict):
    """What `analysis.json` was made from."""

    fingerprint: Any


@dataclass(frozen=True, eq=False)
class DatasetStatistics:
    """The statistics of one dataset, which is one config of a folder."""

    data: Dataset
    splits: Mapping[str, SplitCounts]
    """The counts of each split, in the order of the table of splits."""
    certificate: Certificate
    analysis: Mapping[str, Any] | None = None
    """The result of `read_analysis`."""

    @property
    def manifest(self) -> Manifest:
        """The manifest of the dataset."""
        return self.data.manifest

    @property
    def name(self) -> str:
        """The name of the dataset's config."""
        return self.manifest.config.name

    @property
    def rows(self) -> int:
        """The number of rows of all splits."""
        return sum(counts.rows for counts in self.splits.values())


_counted_last: dict[tuple[DatasetConfig, tuple[Shard, ...]], DatasetStatistics] = {}
"""The dataset that this process counted last, so that `card` need not count it after `analyse`."""


def statistics_of(data_dir: AnyPath, stage: str, workers: int = 1) -> list[DatasetStatistics]:
    """Return the statistics of all finished datasets of a folder, the smallest first.

    Args:
        data_dir: The folder.
        stage: The name to show beside the progress bar.
        workers: The number of processes that read shards.

    Raises:
        DatasetError: The folder has no finished dataset, or a dataset, its manifest or its
            analysis is missing or damaged.
    """
    manifests = front_matter.finished(data_dir)
    if lacking := front_matter.without_manifest(data_dir):
        advice = "move it away, and build it again if you want it back"
        raise DatasetError(f"{lacking[0]} is a dataset without its {Manifest.FILE}: {advice}")
    if not manifests:
        raise DatasetError(f"{data_dir} holds no finished dataset: stages=build makes one")
    datasets = []
    for manifest in manifests:
        data = Dataset.at(data_dir / manifest.config.name, manifest)
        analysis = read_analysis(data)
        known = _counted_last.get((manifest.config, manifest.shards))
        if known is None:
            known = count_dataset(data, workers, stage)
        else:
            checked = zip(manifest.shards, ordered_map(_check, data.files(), workers), strict=True)
            rows = ((shard.rows, None) for shard, _ in checked)
            list(tracked(rows, stage, known.rows))
        datasets.append(replace(known, data=data, analysis=analysis))
    return datasets


def _check(file: ShardFile) -> None:
    """Raise DatasetError if a shard is missing or damaged."""
    with file.opened():
        pass


def count_dataset(
    data: Dataset,
    workers: int = 1,
    stage: str = "count",
    keep: Callable[[str, Content], None] = lambda *_: None,
) -> DatasetStatistics:
    """Return the statistics of a dataset, counted in its shards, without the analysis.

    Args:
        data: The dataset.
        workers: The number of processes.
        stage: The name to show beside the progress bar.
        keep: Called after each shard with the name of its split and its content.

    Raises:
        DatasetError: A shard is missing or damaged, or differs from the manifest.
    """
    config = data.manifest.config
    files = [file for split in config.splits for file in data.files(split)]
    splits: dict[str, SplitCounts] = {}
    keys: dict[str, list[Keys]] = {}
    count = partial(count_shard, (config.height, config.width))
    done = zip(files, ordered_map(count, files, workers), strict=True)
    pairs = ((file.shard.rows, (file.shard.split, counted)) for file, counted in done)
    for split, counted in tracked(pairs, stage, sum(file.shard.rows for file in files)):
        before = splits.get(split)
        splits[split] = counted.counts if before is None else before + counted.counts
        keys.setdefault(split, []).append(counted.keys)
        keep(split, counted.content)
    certificate = certify({split: Keys.joined(parts) for split, parts in keys.items()})
    statistics = DatasetStatistics(data, splits, certificate)
    _counted_last.clear()
    _counted_last[config, data.manifest.shards] = statistics
    return statistics


def read_analysis(data: Dataset) -> dict[str, Any] | None:
    """Return the parts of a dataset's `analysis.json` that the card and the report show.

    Returns:
        None if the file is missing or its fingerprint is not the dataset's.

    Raises:
        DatasetError: The file is damaged.
    """
    path = data.folder / Manifest.ANALYSIS
    try:
        content: _Made = typed.read_as(_Made, File(path).read_json())
        if content["fingerprint"] != data.fingerprint:
            return None
        sums = Sums.read(data.folder)
        if Manifest.ANALYSIS in dict(sums.hashes) and not sums.has(Manifest.ANALYSIS):
            raise ValueError(f"its sha256 is not the one in {Sums.FILE}")
        analysis: _Analysis = typed.read_as(_Analysis, content)
        leakage = analysis["leakage"]
        for pair in leakage["pairs"]:
            if pair["second"] not in leakage["labyrinths"]:
                raise ValueError(f"it.leakage.labyrinths has no {pair['second']}")
    except FileNotFoundError:
        return None
    except (ValueError, RecursionError) as error:
        reason = f"{one_line(error):.300}; stages=analyse overwrite=true writes it again"
        raise DatasetError(f"{path} cannot be read: {reason}") from error
    return {
        "labyrinths": leakage["labyrinths"],
        "repeated": leakage["repeated"],
        "strangers": {split: len(ids) for split, ids in leakage["strangers"].items()},
        "pairs": [_pair(pair) for pair in leakage["pairs"]],
        "permutations": analysis["shift"]["permutations"],
        "shift": analysis["shift"]["measures"],
    }


def _pair(pair: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "first": pair["first"],
        "second": pair["second"],
        "counts": {kind: len(pair[kind]) for kind in KINDS},
        "examples": {kind: list(pair[kind].items())[:MOST_NAMED] for kind in KINDS},
        "within": {walls: pair["within"][walls] for walls in "123"},
        "spread": pair["spread"],
    }
