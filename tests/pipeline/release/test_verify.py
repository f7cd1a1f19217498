"""The verification of a release, with a folder in the place of the Hub."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from making import make
from planting import DEFAULT

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Manifest
from pipeline.inspection import front_matter
from pipeline.release import verify
from pipeline.release.verify import check_config


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "labyrinths", "message"),
    [
        (1, 7, "{0} train: the first rows are not those that were published"),
        (0, 6, "{0} train: there are 35 rows instead of 30"),
    ],
)
def test_rows_that_are_not_the_published_ones_are_found(
    carded: Path, tmp_path: Path, seed: int, labyrinths: int, message: str
) -> None:
    for manifest in front_matter.finished(carded):
        check_config(str(carded), None, manifest, carded)
    other = make(tmp_path, DEFAULT, labyrinths=labyrinths, random_steps=25, seed=seed)
    with pytest.raises(DatasetError) as error:
        check_config(str(carded), None, Manifest.read(other), tmp_path)
    assert str(error.value) == message.format(DEFAULT)


def test_a_folder_of_the_cache_that_is_renamed_meanwhile_does_not_end_the_watch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("half/shard", "other/shard"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_bytes(b"12345")
    scandir = os.scandir

    def renaming(path: Any) -> Any:
        if Path(path).name == "half":
            Path(path).rename(tmp_path / "whole")
        return scandir(path)

    monkeypatch.setattr(os, "scandir", renaming)
    assert verify._bytes_in(tmp_path) == 5
