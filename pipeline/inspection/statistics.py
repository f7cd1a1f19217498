"""The numbers of a dataset that its card and the report show: its counts and its analysis.

The analysis is in the file that the stage `analyse` has left, if it has.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from labyrinth_core.data.errors import MALFORMED, DatasetError, one_line
from labyrinth_core.data.manifest import ANALYSIS, Manifest
from labyrinth_core.data.storage import AnyPath
from labyrinth_core.pictures.renderer import DEFAULT_STYLE, Colour
from labyrinth_core.world.grid import Action
from pipeline.inspection.counting import counts_of
from pipeline.inspection.counts import DatasetCounts, SplitCounts
from pipeline.machinery import front_matter
from pipeline.machinery.console import progress
from pipeline.machinery.schema import (
    COUNT,
    SHARE,
    Each,
    Maybe,
    Named,
    Number,
    Text,
    check,
    read_json,
)

ACTION_COLOURS: dict[Action, Colour] = {
    Action.UP: DEFAULT_STYLE.agent,
    Action.RIGHT: DEFAULT_STYLE.goal,
    Action.DOWN: DEFAULT_STYLE.start,
    Action.LEFT: DEFAULT_STYLE.key,
}
"""The colours of actions in figures."""

MOST_NAMED = 20
"""The most labyrinths shared by two splits that are named, of each kind."""
KINDS = ("equal", "mirrored", "symmetric", "same_route")
"""The kinds of what two labyrinths may have in common."""

_SPLIT = Text(r"\w{1,99}")
_ID = Text(r"[0-9a-f]{16}")
_BOTH = {"first": _SPLIT, "second": _SPLIT}
_ANALYSIS = {
    "leakage": {
        "labyrinths": Named(_SPLIT, COUNT),
        "repeated": Named(_SPLIT, COUNT),
        "strangers": Named(_SPLIT, Each(_ID)),
        "pairs": Each(
            _BOTH
            | dict.fromkeys(KINDS, Named(_ID, _ID))
            | {"within": dict.fromkeys("123", COUNT), "spread": Text(r"[\w., -]{0,99}")}
        ),
    },
    "shift": {
        "permutations": COUNT,
        "measures": Each(
            _BOTH
            | {"measure": Text(r"\w[\w ]{0,99}"), "labyrinths": (COUNT, COUNT)}
            | {"distance": Number(0), "effect": Maybe(Number())}
            | {"p_value": SHARE, "corrected": SHARE}
        ),
    },
}
"""What the card and the report use of an analysis."""


@dataclass(frozen=True, eq=False)
class DatasetStatistics:
    """The numbers of one dataset, one config of a folder."""

    manifest: Manifest
    counts: DatasetCounts
    analysis: Mapping[str, Any] | None = None
    """As from `read_analysis`."""

    @property
    def name(self) -> str:
        """The name of its config."""
        return self.manifest.config.name

    @property
    def splits(self) -> Mapping[str, SplitCounts]:
        """The counts of each split, in the order of the table of splits."""
        return self.counts.splits

    @property
    def rows(self) -> int:
        """The number of rows of all splits."""
        return sum(counts.rows for counts in self.splits.values())


def statistics_of(data_dir: AnyPath, stage: str, workers: int = 1) -> list[DatasetStatistics]:
    """Return the statistics of all finished datasets of a folder, the smallest first.

    Args:
        data_dir: The folder.
        stage: The stage that asks for them, named beside the progress bar.
        workers: The number of processes that read shards.

    Raises:
        DatasetError: There is no dataset, or one, or what was found out about it, is damaged.
    """
    manifests = front_matter.finished(data_dir)
    if not manifests:
        raise DatasetError(f"{data_dir} holds no finished dataset: stages=[build] makes one")
    datasets = []
    with progress() as bars:
        rows = sum(shard.rows for manifest in manifests for shard in manifest.shards)
        bar = bars.add_task(stage, total=rows)
        for manifest in manifests:
            folder = data_dir / manifest.config.name
            analysis = read_analysis(folder, manifest)
            counts = counts_of(folder, manifest, workers, lambda rows: bars.advance(bar, rows))
            datasets.append(DatasetStatistics(manifest, counts, analysis))
    return datasets


def read_analysis(folder: AnyPath, manifest: Manifest) -> dict[str, Any] | None:
    """Return what the stage `analyse` has found out about a dataset, None if it has not.

    An analysis of other rows, which were in the folder before, does not count.

    Raises:
        DatasetError: The file is damaged.
    """
    path = folder / ANALYSIS
    try:
        content = read_json(path)
        if content["fingerprint"] != manifest.fingerprint:
            return None
        check(content, _ANALYSIS)
        leakage = content["leakage"]
        for pair in leakage["pairs"]:
            check(leakage["labyrinths"], {pair["second"]: COUNT}, "it.leakage.labyrinths")
        return {
            "labyrinths": leakage["labyrinths"],
            "repeated": leakage["repeated"],
            "strangers": {split: len(ids) for split, ids in leakage["strangers"].items()},
            "pairs": [_pair(pair) for pair in leakage["pairs"]],
            "permutations": content["shift"]["permutations"],
            "shift": content["shift"]["measures"],
        }
    except FileNotFoundError:
        return None
    except MALFORMED as error:
        reason = f"{one_line(error):.300}; stages=[analyse] writes it anew"
        raise DatasetError(f"{path} cannot be read: {reason}") from error


def _pair(pair: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "first": pair["first"],
        "second": pair["second"],
        "counts": {kind: len(pair[kind]) for kind in KINDS},
        "examples": {kind: list(pair[kind].items())[:MOST_NAMED] for kind in KINDS},
        "within": {walls: pair["within"][walls] for walls in "123"},
        "spread": pair["spread"],
    }
