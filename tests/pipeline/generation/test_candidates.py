"""The candidates of a dataset in chunks, and datasets that need more than one."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from joblib.externals.loky import get_reusable_executor
from support.crashing import CrashError, before_each_shard
from support.making import Run
from support.tampering import content_of, cut_short

from labyrinth_core.data import SPLITS, Dataset, DatasetConfig, Drawing, Manifest
from labyrinth_core.world import Structure
from pipeline.generation.check import validate
from pipeline.generation.labyrinths import UNFIT, Records, pack, unpack
from pipeline.generation.structures import Candidates, sample

Build = Callable[..., Run]

CHUNKS = 16 * 40, 16 * 15
"""The cells of chunks of 40 and of 15 candidates at 4x4."""
OF_CHUNKS = {"size": "4", "labyrinths": 20, "random_steps": 20, "cells_per_chunk": CHUNKS}


@pytest.fixture(scope="module")
def config(make_run: Callable[..., Run]) -> DatasetConfig:
    return make_run(Path("nowhere"), size="4", labyrinths=20, task="key_and_door").dataset


@pytest.fixture(scope="module")
def of_chunks(build: Build, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A dataset whose structures come from several chunks."""
    return build(tmp_path_factory.mktemp("chunks") / "labyrinth", **OF_CHUNKS)


@pytest.mark.slow
def test_candidates_are_the_same_however_many_are_taken_at_once(config: DatasetConfig) -> None:
    def drawn(counts: list[int]) -> Records:
        candidates, found = Candidates(config, cells=CHUNKS), candidates_of_none
        for count in cycle(counts):
            found = np.concatenate([found, candidates.after(len(found), count)])
            if len(found) >= 85:
                return found[:85]
        raise AssertionError

    candidates_of_none = pack(config, [])
    whole = drawn([85])
    for counts in ([40, 45], [1], [41, 1], [3, 100], [7, 30, 3, 1]):
        assert (drawn(counts) == whole).all()


@pytest.mark.parametrize("options", [{"goals": "varied"}, {"task": "key_and_door"}], ids=str)
def test_labyrinths_can_be_drawn_without_a_build(
    make_run: Callable[..., Run], monkeypatch: pytest.MonkeyPatch, options: dict[str, str]
) -> None:
    config = make_run(Path("nowhere"), size="4", labyrinths=20, **options).dataset
    taken = sample(config, Candidates(config, cells=CHUNKS)).structures
    monkeypatch.setattr(Drawing, "CELLS_PER_CHUNK", CHUNKS)
    for split in SPLITS.sampled:
        structures = unpack(config, taken[split])
        assert list(islice(Drawing(config).labyrinths(split), config.labyrinths)) == [
            Drawing(config).labyrinth(split, each) for each in structures
        ]


@given(st.integers(0, 2**32), st.integers(2, 9), st.integers(2, 9))
def test_structures_are_unpacked_as_they_were_packed(
    make_run: Callable[..., Run], seed: int, height: int, width: int
) -> None:
    config = make_run(Path("nowhere"), size=f"{height}x{width}", labyrinths=1).dataset
    drawn = Structure.sample(height, width, np.random.default_rng(seed))
    structures = [*islice(drawn, 3), Structure.without_walls(height, width)]
    records = pack(config, [(each, UNFIT) for each in structures])
    assert list(unpack(config, records)) == structures
    assert records["id"].tolist() == [int(each.structure_id, 16) for each in structures]


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"size": "3"}, {"size": "4", "task": "icy_floor"}], ids=str)
def test_a_shorter_dataset_of_chunks_is_the_beginning_of_a_longer_one(
    make_run: Callable[..., Run], options: dict[str, Any]
) -> None:
    def found(labyrinths: int) -> dict[str, Records]:
        run = make_run(Path("nowhere"), labyrinths=labyrinths, **options)
        candidates = Candidates(run.dataset, cells=CHUNKS)
        return dict(sample(run.dataset, candidates).structures)

    longer = found(60)
    for labyrinths in (1, 10, 30, 59):
        for split, records in found(labyrinths).items():
            assert (records == longer[split][:labyrinths]).all()
    for records in longer.values():
        assert len(set(records["id"].tolist())) == 60


@pytest.mark.slow
def test_only_a_dataset_that_one_chunk_does_not_suffice_for_has_the_newer_format(
    build: Build, tmp_path: Path, of_chunks: Run, small_dataset: Run
) -> None:
    manifest = Manifest.read(of_chunks.folder)
    assert manifest.format == 3
    assert validate(Dataset.at(of_chunks.folder)) == []
    assert Manifest.read(small_dataset.folder).format == 2
    begun = build(tmp_path / "a", **OF_CHUNKS | {"labyrinths": 8})
    whole = build(tmp_path / "b", **OF_CHUNKS | {"labyrinths": 8, "cells_per_chunk": (10**6, 1)})
    assert Manifest.read(begun.folder).format == 2
    assert content_of(begun.data_dir) == content_of(whole.data_dir)


@pytest.mark.slow
def test_two_workers_make_the_bytes_that_one_makes_and_find_them_valid(
    build: Build, tmp_path: Path, of_chunks: Run
) -> None:
    try:
        run = build(tmp_path, **OF_CHUNKS, workers=2)
        problems = validate(Dataset.at(run.folder), workers=2)
    finally:
        get_reusable_executor().shutdown(wait=True)
    assert content_of(run.data_dir) == content_of(of_chunks.data_dir)
    assert problems == []


@pytest.mark.slow
@pytest.mark.parametrize("damage", [None, cut_short, Path.unlink])
def test_a_build_that_goes_on_draws_only_the_chunks_that_are_missing(
    build: Build, tmp_path: Path, of_chunks: Run, damage: Callable[[Path], None] | None
) -> None:
    building = tmp_path / ".4x4.building"
    times: list[dict[str, int]] = []

    def stop() -> None:
        times.append({path.name: path.stat().st_mtime_ns for path in building.glob("*.chunk")})
        raise CrashError

    for _ in range(2):
        with before_each_shard(stop), pytest.raises(CrashError):
            build(tmp_path, **OF_CHUNKS)
        chunks = sorted(building.glob("*.chunk"))
        if damage and len(times) == 1:
            damage(chunks[1])
    assert len(chunks) >= 3
    changed = {path.name for path in chunks if times[0][path.name] != times[1][path.name]}
    assert changed == ({chunks[1].name} if damage else set())
    assert content_of(build(tmp_path, **OF_CHUNKS).data_dir) == content_of(of_chunks.data_dir)


def test_a_damaged_shard_of_a_dataset_of_chunks_is_made_anew(
    build: Build, tmp_path: Path, of_chunks: Run
) -> None:
    run = build(tmp_path, **OF_CHUNKS)
    (run.folder / "test-00000-of-00001.parquet").unlink()
    build(tmp_path, **OF_CHUNKS)
    assert content_of(run.data_dir) == content_of(of_chunks.data_dir)
