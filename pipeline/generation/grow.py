"""The shards of a dataset that a shorter one has already, of which a longer one is made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Manifest, Shard, current_versions
from pipeline.generation.candidates import Records
from pipeline.generation.tabulate import Facts, table_facts


@dataclass(frozen=True, eq=False)
class OldShard:
    """A shard of a shorter dataset."""

    path: Path
    shard: Shard
    facts: Facts
    """The facts of its labyrinths."""


def unchanged(
    folder: Path, shorter: Manifest, structures: Mapping[str, Records], size: int
) -> dict[tuple[str, int], OldShard]:
    """Return the shards that stay as they are, by split and the number of the first labyrinth.

    Those are all that the shorter dataset has filled, or none if it was built with other versions
    of libraries.

    Args:
        folder: The folder of the shorter dataset.
        shorter: Its manifest.
        structures: The structures of the longer one, for each split that has its own.
        size: The number of labyrinths in a shard.

    Raises:
        DatasetError: The longer one would not have all labyrinths of the shorter one; or the table
            of the shorter one is missing or damaged.
    """
    facts, first, kept = table_facts(folder, shorter), 0, {}
    same_versions = dict(shorter.versions) == current_versions()
    for split in shorter.config.splits:
        shards, begin = shorter.of(split), first
        for number, shard in enumerate(shards):
            own = facts[first : first + shard.labyrinths]
            first += shard.labyrinths
            is_full = (number + 1) * size <= shorter.config.labyrinths
            if is_full and same_versions:
                kept[split, number * size] = OldShard(folder / shard.path, shard, own)
        if split in structures:
            _check_first(folder, shorter, facts[begin:first], structures[split])
    return kept


def _check_first(folder: Path, shorter: Manifest, facts: Facts, records: Records) -> None:
    if not np.array_equal(facts["structure_id"], records["id"][: len(facts)]):
        raise DatasetError(
            f"{folder} holds a dataset with labyrinths={shorter.config.labyrinths}, not all of "
            "which are in a longer one: choose another data_dir, or give overwrite=true"
        )
