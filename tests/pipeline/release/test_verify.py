"""The verification of a release, with a folder in the place of the Hub."""

from __future__ import annotations

from pathlib import Path

import pytest
from making import make
from planting import DEFAULT

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Manifest
from pipeline.inspection import front_matter
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
