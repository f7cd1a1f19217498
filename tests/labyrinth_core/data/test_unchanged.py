"""What is opened is what was asked for, and stays the same while it is read."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from support.making import Run
from support.tampering import cut_short

from labyrinth_core import (
    Dataset,
    DatasetError,
    evaluate,
    load_arrays,
    load_episodes,
    load_transitions,
    stream_episodes,
)
from labyrinth_core.data import rows

REPLACED = r"\A[^\n]*3x3 was replaced or grew while it was read: run this again\Z"


@pytest.fixture
def data_dir(build: Callable[..., Run], tmp_path: Path) -> Path:
    """A dataset of three shards a split."""
    return build(tmp_path / "data", labyrinths=6, cells_per_shard=18).data_dir


def walk(observations: object) -> list[int]:
    return [0] * len(observations)  # type: ignore[arg-type]


OTHER_NAME = (
    r"\A[^\n]*/4x4 holds the dataset 3x3, not 4x4: give the folder the name 3x3, or [^\n]+\Z"
)


@pytest.mark.parametrize(
    "read",
    [
        lambda folder: load_transitions(folder, "4x4"),
        lambda folder: load_episodes(folder, "4x4"),
        lambda folder: stream_episodes(folder, "4x4"),
        lambda folder: load_arrays(folder, "4x4", "test"),
        lambda folder: evaluate(walk, folder, "4x4"),
        lambda folder: Dataset(folder, "4x4"),
    ],
)
@pytest.mark.parametrize("linked", [False, True])
def test_a_dataset_under_another_name_is_refused(
    small_dataset: Run, tmp_path: Path, read: Callable[[Path], object], linked: bool
) -> None:
    folder = tmp_path / "4x4"
    if linked:
        folder.symlink_to(small_dataset.folder)
    else:
        shutil.copytree(small_dataset.folder, folder)
    with pytest.raises(DatasetError, match=OTHER_NAME):
        read(tmp_path)


def test_a_link_of_the_right_name_leads_to_a_dataset_of_any(
    small_dataset: Run, tmp_path: Path
) -> None:
    (tmp_path / "3x3").symlink_to(shutil.copytree(small_dataset.folder, tmp_path / "large"))
    assert len([*load_episodes(tmp_path, "3x3")]) == 8


def replace_dataset(build: Callable[..., Run], data_dir: Path) -> None:
    build(data_dir, labyrinths=6, cells_per_shard=18, seed=1, overwrite=True)


@pytest.mark.parametrize("cause", ["overwritten", "grown", "gone"])
@pytest.mark.parametrize("read", [load_episodes, stream_episodes])
def test_a_dataset_that_is_replaced_while_it_is_read_is_not_called_damaged(
    build: Callable[..., Run], data_dir: Path, read: Callable[..., object], cause: str
) -> None:
    episodes = iter(read(data_dir, "3x3", observation="vector"))
    next(episodes)
    if cause == "overwritten":
        replace_dataset(build, data_dir)
    elif cause == "grown":
        build(data_dir, labyrinths=9, cells_per_shard=18, grow=True)
    else:
        shutil.rmtree(data_dir / "3x3")
    with pytest.raises(DatasetError, match=REPLACED):
        list(episodes)


def test_a_shard_that_is_damaged_meanwhile_is_called_damaged(data_dir: Path) -> None:
    episodes = load_episodes(data_dir, "3x3", observation="vector")
    next(episodes)
    cut_short(data_dir / "3x3" / "train-00001-of-00003.parquet")
    with pytest.raises(DatasetError, match=r"is damaged: it has \d+ bytes, and the manifest says"):
        list(episodes)


def test_a_table_that_was_replaced_is_not_called_damaged(
    build: Callable[..., Run], data_dir: Path
) -> None:
    before = Dataset(data_dir, "3x3")
    replace_dataset(build, data_dir)
    with pytest.raises(DatasetError, match=REPLACED):
        _ = before.table


def test_a_shard_is_the_same_when_it_is_hashed_and_when_it_is_opened(
    data_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def check_file(path: Path, *_: object) -> None:
        path.with_name("other").write_bytes(path.read_bytes())
        path.with_name("other").replace(path)

    monkeypatch.setattr(rows, "check_file", check_file)
    with pytest.raises(DatasetError, match="has changed while it was opened"):
        list(load_episodes(data_dir, "3x3"))
