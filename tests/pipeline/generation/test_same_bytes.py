"""What a config stands for does not change: the fingerprints of small datasets, as once published.

A test here fails where rows differ from those of earlier versions. Then the change is an error, or
all datasets of that kind get another `manifest.FORMAT`, and `just renew` writes the new ones down.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from support.making import DemonstrationsConfig, Run

from labyrinth_core.data import SPLITS, Manifest
from labyrinth_core.world import Task

EXPECTED: dict[str, dict[str, str]] = json.loads(
    (Path(__file__).parents[2] / "data" / "fingerprints.json").read_text(encoding="utf-8")
)
"""Case -> split -> the first 16 digits of the fingerprint of its only shard."""

CASES: Mapping[str, Mapping[str, Any]] = {
    "all shifts": {"size": "5", "shifts": ("all",)},
    **{str(task): {"task": str(task)} for task in Task if task is not Task.NAVIGATION},
    "key_and_door": {"task": "key_and_door", "solutions": "all"},
    "icy_floor": {"task": "icy_floor", "size": "4x5"},
    "noise": {"demonstrations": DemonstrationsConfig(noise=0.3)},
    "goals": {"goals": "varied", "shifts": ("all",)},
    "prim": {"sampler": "prim", "open_walls": 0.4, "shifts": ("wilson",)},
}
"""What differs from 4x4 with six labyrinths a split."""


def fingerprints(run: Run) -> dict[str, str]:
    return {shard.split: shard.fingerprint[:16] for shard in Manifest.read(run.folder).shards}


@pytest.mark.parametrize("case", CASES)
def test_a_dataset_has_the_rows_that_it_always_had(
    build: Callable[..., Run],
    tmp_path: Path,
    case: str,
    as_always: Callable[[str, str, Any], None],
) -> None:
    small = {"size": "4", "labyrinths": 6, "random_steps": 10}
    found = fingerprints(build(tmp_path, **{**small, **CASES[case]}))
    as_always("fingerprints.json", case, found)


def test_a_split_that_is_new_comes_with_its_fingerprint() -> None:
    assert {split for case in EXPECTED.values() for split in case} == set(SPLITS)
