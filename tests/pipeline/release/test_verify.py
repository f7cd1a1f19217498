"""The verification of a release, with a folder in the place of the Hub."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from planting import DEFAULT

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Manifest
from pipeline.release.verify import _check_table


@pytest.mark.parametrize(("seed", "labyrinths", "row"), [(1, 7, 0), (0, 6, 6)])
def test_a_table_of_labyrinths_that_is_not_the_published_one_is_found(
    carded: Path,
    build_dataset: Callable[..., Path],
    tmp_path: Path,
    seed: int,
    labyrinths: int,
    row: int,
) -> None:
    _check_table(str(carded), None, Manifest.read(carded / DEFAULT), carded)
    options = {"labyrinths": labyrinths, "random_steps": 25, "seed": seed}
    other = build_dataset(tmp_path, DEFAULT, **options)
    with pytest.raises(DatasetError) as error:
        _check_table(str(carded), None, Manifest.read(other), tmp_path)
    assert str(error.value) == f"{DEFAULT}-labyrinths: row {row} is not the one that was published"
