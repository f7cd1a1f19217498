"""Cards of datasets that are links into a store, or in an object store."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from support.making import Run
from support.s3_server import bucket, content_of, memory, server
from support.tampering import linked

from labyrinth_core.errors import DatasetError
from pipeline.release import card
from pipeline.release.texts import Release

__all__ = ["bucket", "memory", "server"]

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("store", ["memory", "bucket"])
def test_the_card_of_a_dataset_in_a_store_is_that_of_the_local_one(
    request: pytest.FixtureRequest,
    build: Callable[..., Run],
    store: str,
    small_dataset: Run,
    tmp_path: Path,
) -> None:
    run = build(request.getfixturevalue(store))
    shutil.copytree(small_dataset.data_dir, tmp_path, dirs_exist_ok=True)
    local = replace(small_dataset, data_dir=tmp_path)
    for each in (run, local):
        card.run(each)
    assert content_of(run.data_dir) == content_of(local.data_dir)


def test_a_card_of_links_into_a_store_never_changes_the_store(
    build: Callable[..., Run], small_dataset: Run, tmp_path: Path
) -> None:
    data_dir = Path(shutil.copytree(small_dataset.data_dir, tmp_path / "data"))
    card.write_card(data_dir)
    store = linked(data_dir, tmp_path / "store")
    build(data_dir, size="2x3", labyrinths=1)
    card.write_card(data_dir)
    assert content_of(tmp_path / "store") == store
    assert not (data_dir / "README.md").is_symlink()


def test_no_pictures_are_written_through_a_link(small_dataset: Run, tmp_path: Path) -> None:
    data_dir = Path(shutil.copytree(small_dataset.data_dir, tmp_path / "data"))
    card.write_card(data_dir)
    elsewhere = tmp_path / "elsewhere"
    (data_dir / "pictures").rename(elsewhere)  # Listed, with the hashes of these files.
    (data_dir / "pictures").symlink_to(elsewhere)
    before = content_of(elsewhere)
    with pytest.raises(DatasetError, match="pictures is a link, and nothing is written through it"):
        card.write_card(data_dir, Release("user/name", "1.0.0"))
    assert content_of(elsewhere) == before
