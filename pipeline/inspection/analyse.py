"""The stage `analyse`, and the statistics of datasets that card and report show.

The stage writes the leakage and the shift between the splits of a dataset to `analysis.json` in the
dataset's folder. Statistics are the counts of the shards, and the content of that file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, TypedDict

from labyrinth_core import typed
from labyrinth_core.data import SPLITS, Dataset, Manifest
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.storage import AnyPath, File
from pipeline.config import Job, WorkOptions
from pipeline.inspection import front_matter
from pipeline.inspection.leakage import find_leakage
from pipeline.inspection.shift import PERMUTATIONS, compare
from pipeline.inspection.statistics import Content, DatasetStatistics, count_dataset
from pipeline.machinery import Sums, leave, say

FORMAT = 1
"""The format of an analysis."""
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


def run(job: Job[WorkOptions]) -> None:
    """Analyse the dataset of a job, and leave the result in its folder.

    Raises:
        DatasetError: The dataset is missing or damaged.
        OSError: The result cannot be written.
    """
    data = Dataset.at(job.folder)
    config = data.manifest.config
    parts: dict[str, list[Content]] = {}
    statistics = count_dataset(
        data,
        job.options.workers,
        "analyse",
        keep=lambda split, content: parts.setdefault(split, []).append(content),
    )
    contents = {split: Content.joined(of_split) for split, of_split in parts.items()}
    labyrinths = {split: content.labyrinths for split, content in contents.items()}
    leakage = find_leakage(labyrinths, statistics.certificate)
    pairs = [("train", split) for split in SPLITS.base[1:]] + [("validation", "test")]
    shifts = compare(contents, pairs, config.seed)
    for shift in config.shifts:  # Each has its own question, and its own family of tests.
        shifts += compare(contents, [(SPLITS[shift].parent or "test", shift)], config.seed)
    content = {
        "name": config.name,
        "fingerprint": data.fingerprint,
        "leakage": leakage.to_json(),
        "shift": {
            "permutations": PERMUTATIONS,
            "measures": [shift.to_json() for shift in shifts],
        },
    }
    text = as_text(content).encode()
    leave(job.folder, {Manifest.ANALYSIS: text}, overwrite=job.options.overwrite)
    for line in leakage.lines({}):
        say(line)
    say(f"Wrote {job.folder / Manifest.ANALYSIS} (near-duplicates, tests of shift).")


def as_text(content: Mapping[str, Any]) -> str:
    """Return the JSON of an analysis."""
    return json.dumps({"format": FORMAT} | dict(content), indent=1) + "\n"


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
        datasets.append(replace(count_dataset(data, workers, stage), analysis=analysis))
    return datasets


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
