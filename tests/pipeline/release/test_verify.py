"""The sample of a release that is loaded, with a folder in the place of the Hub."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from support.making import make
from support.planting import DEFAULT

from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import LocalFile
from pipeline.inspection import front_matter
from pipeline.release import verify


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
    assert verify.verify(str(carded), None, carded) == "every config loads"
    make(tmp_path, DEFAULT, labyrinths=labyrinths, random_steps=25, seed=seed)
    described = front_matter.described(front_matter.finished(tmp_path))
    config, info = described["configs"][0], described["dataset_info"][0]
    with pytest.raises(DatasetError) as error:
        verify.check_config(str(carded), None, tmp_path, config, info, streaming=False)
    assert str(error.value) == message.format(DEFAULT)


def test_what_a_killed_verification_left_is_removed_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    left, running = tmp_path / f"{verify.PREFIX}left", tmp_path / f"{verify.PREFIX}running"
    for folder in (left, running):
        folder.mkdir()
        (folder / "download").write_bytes(b"half")
    left.with_name(f"{left.name}.lock").touch()
    with LocalFile(running.with_name(f"{running.name}.lock")).locked():
        with verify._scratch() as place:
            assert {*tmp_path.iterdir()} == {
                *(each for folder in (running, place) for each in (folder, _lock_of(folder)))
            }
        assert {*tmp_path.iterdir()} == {running, _lock_of(running)}


def _lock_of(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.lock")
