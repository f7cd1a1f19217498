"""Which structures are sampled, in which split they are, and what labyrinths they become."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.brute_force import (
    all_structures,
    is_connected,
    passages_of,
)
from support.making import Run, SplitsConfig

from labyrinth_core.data import SPLITS, DatasetConfig, Drawing
from labyrinth_core.world import ALGORITHMS, BUCKETS, Structure
from pipeline.config import ConfigError
from pipeline.generation.labyrinths import unpack
from pipeline.generation.structures import check_capacity, sample

MakeRun = Callable[..., Run]


@pytest.fixture(scope="session")
def config_of(make_run: MakeRun) -> Callable[..., DatasetConfig]:
    return lambda **options: make_run(Path("nowhere"), **options).dataset


@pytest.fixture(scope="module")
def connected_3x3() -> list[Structure]:
    """Each connected structure of 3x3, found by trying every set of passages."""
    return [s for s in all_structures(3, 3) if is_connected(3, 3, passages_of(s))]


def structures_of(config: DatasetConfig) -> dict[str, list[Structure]]:
    return {split: [*unpack(config, of)] for split, of in sample(config).structures.items()}


VARIETY: list[dict[str, Any]] = [
    {"size": "3", "labyrinths": 100},
    {"size": "3", "labyrinths": 40, "sampler": "kruskal", "open_walls": 0.5},
    {"size": "3", "labyrinths": 20, "task": "key_and_door"},
    {"size": "4", "labyrinths": 20, "task": "icy_floor"},
    *({"size": "4", "labyrinths": 150, "sampler": name} for name in ALGORITHMS),
    {"size": "4", "labyrinths": 400, "sampler": "depth_first", "open_walls": 0.0},
    {"size": "5", "labyrinths": 300, "buckets": (60, 30, 10)},
    *({"size": size, "labyrinths": 200} for size in ("3x5", "5x3")),
]


@pytest.mark.slow
@pytest.mark.parametrize("options", VARIETY, ids=str)
def test_structures_are_unique_and_connected_and_where_their_hash_says(
    config_of: Callable[..., DatasetConfig], options: dict[str, Any]
) -> None:
    """So none is in two splits, neither of this dataset nor of any two with the same buckets."""
    config = config_of(**options)
    splits = structures_of(config)
    assert list(splits) == list(SPLITS.sampled)
    everything = [passages_of(s) for structures in splits.values() for s in structures]
    assert len(set(everything)) == len(everything) == 3 * config.labyrinths
    assert all(is_connected(config.height, config.width, each) for each in everything)
    for split, structures in splits.items():
        assert {structure.split(config.buckets) for structure in structures} == {split}


SIDES = st.integers(2, 7)


@given(st.integers(0, 2**64 - 1), SIDES, SIDES, st.sampled_from(sorted(ALGORITHMS)))
def test_a_mirror_image_that_keeps_start_and_goal_has_the_same_split(
    seed: int, height: int, width: int, algorithm: str
) -> None:
    rng = np.random.default_rng(seed)
    structure = next(Structure.sample(height, width, rng, algorithm=algorithm))
    for buckets in (BUCKETS, (80, 10, 10), (1, 1, 98)):
        assert structure.transposed().split(buckets) == structure.split(buckets)


def test_with_varied_goals_all_images_of_a_structure_of_any_shape_share_one_split(
    config_of: Callable[..., DatasetConfig],
) -> None:
    config = config_of(size="2x3", goals="varied", labyrinths=1)
    connected = [each for each in all_structures(2, 3) if each.is_connected]
    for structure in connected:
        found = {config.bucket_of(image) for image in structure.symmetries()}
        assert len(found - {None}) == 1


@pytest.mark.slow
def test_splits_have_their_share_of_all_structures(connected_3x3: list[Structure]) -> None:
    rng = np.random.default_rng(0)
    structures = [s for s, _ in zip(Structure.sample(6, 6, rng), range(4_000), strict=False)]
    for buckets in (BUCKETS, (80, 15, 5)):
        counts = Counter(structure.split(buckets) for structure in structures)
        for split, percent in zip(SPLITS.sampled, buckets, strict=True):
            assert abs(counts[split] / 40 - percent) < 3
    assert len(connected_3x3) == 431
    assert set(Counter(s.split(BUCKETS) for s in connected_3x3)) == set(SPLITS.sampled)


# How many there can be.


@pytest.mark.parametrize("buckets", [BUCKETS, (60, 20, 20), (25, 25, 50)])
def test_the_capacity_of_3x3_is_what_brute_force_counts(
    config_of: Callable[..., DatasetConfig],
    connected_3x3: list[Structure],
    buckets: tuple[int, int, int],
) -> None:
    counts = Counter(structure.split(buckets) for structure in connected_3x3)
    most = min(counts.values())
    check_capacity(config_of(labyrinths=most, buckets=buckets))
    check_capacity(config_of(size="5", labyrinths=10**9))  # These are not counted.
    with pytest.raises(ConfigError) as caught:
        check_capacity(config_of(labyrinths=most + 1, buckets=buckets))
    listed = ", ".join(f"{counts[split]} in {split}" for split in SPLITS.sampled)
    assert str(caught.value) == (
        f"size=3x3 labyrinths={most + 1}: there can be {listed}; ask for labyrinths={most} or fewer"
    )


def test_every_structure_of_3x3_can_come_up(
    config_of: Callable[..., DatasetConfig], connected_3x3: list[Structure]
) -> None:
    counts = Counter(structure.split(BUCKETS) for structure in connected_3x3)
    most = min(counts.values())
    full = next(split for split in SPLITS.sampled if counts[split] == most)
    found = structures_of(config_of(labyrinths=most))
    expected = {s for s in connected_3x3 if s.split(BUCKETS) == full}
    assert set(found[full]) == expected


@pytest.mark.slow
@pytest.mark.parametrize("task", ["icy_floor", "key_and_door"])
def test_the_capacity_for_a_task_is_what_can_be_sampled(
    config_of: Callable[..., DatasetConfig], task: str
) -> None:
    with pytest.raises(ConfigError, match="ask for labyrinths=") as caught:
        check_capacity(config_of(task=task, labyrinths=431))
    most = int(str(caught.value).split("ask for labyrinths=")[1].split()[0])
    assert 0 < most < 431 // 3
    check_capacity(config_of(task=task, labyrinths=most))
    with pytest.raises(ConfigError, match=f"ask for labyrinths={most} or fewer"):
        check_capacity(config_of(task=task, labyrinths=most + 1))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        # Ice cannot matter at this size.
        (
            {"size": "2x3", "task": "icy_floor", "labyrinths": 1},
            "there can be 0 in train, 0 in validation, 0 in test; choose another size or task",
        ),
        ({"size": "5", "labyrinths": 10**20}, r"fewer than 2\*\*40"),
        # With all walls open there is only one structure.
        (
            {"size": "4", "labyrinths": 2, "open_walls": 1.0},
            r"labyrinths=2: of 4x4 the sampler found .* in 500 draws",
        ),
        (
            {"labyrinths": 32, "splits": SplitsConfig(4)},
            r"^labyrinths=32: of 3x3 the sampler found 32 in train, \d in validation, \d in test "
            r"at least splits.min_walls=4 walls apart, and no other in 500 draws; ask for fewer of",
        ),
    ],
    ids=str,
)
def test_more_labyrinths_than_there_are_or_can_be_found_are_refused(
    config_of: Callable[..., DatasetConfig],
    options: dict[str, Any],
    words: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Drawing, "PATIENCE", 500)

    def drawn(config: DatasetConfig) -> None:
        check_capacity(config)
        sample(config)

    with pytest.raises(ConfigError, match=words):
        drawn(config_of(**options))


# How far apart.


def walls_between(one: Structure, other: Structure) -> int:
    return len(passages_of(one) ^ passages_of(other))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "walls"),
    [
        ({"size": "3", "labyrinths": 20}, 2),
        ({"size": "4", "labyrinths": 60}, 3),
        ({"size": "4x3", "labyrinths": 20, "task": "key_and_door"}, 2),
        ({"size": "5", "labyrinths": 50}, 8),
    ],
    ids=str,
)
def test_structures_of_two_splits_are_as_many_walls_apart_as_asked_for(
    config_of: Callable[..., DatasetConfig], options: dict[str, Any], walls: int
) -> None:
    plain = structures_of(config_of(**options))
    config = config_of(**options, splits=SplitsConfig(walls))
    apart = structures_of(config)
    least = [
        min(walls_between(a, b) for a in found[first] for b in found[second])
        for found in (plain, apart)
        for first, second in combinations(SPLITS.sampled, 2)
    ]
    assert min(least[:3]) < walls <= min(least[3:])
    assert apart == structures_of(config)
    assert apart["train"] == plain["train"]
    for split, structures in apart.items():
        assert len(set(structures)) == config.labyrinths
        assert {structure.split(config.buckets) for structure in structures} == {split}


def test_no_two_structures_share_their_randomness(
    config_of: Callable[..., DatasetConfig],
) -> None:
    config = config_of(size="4", labyrinths=20)
    structures = structures_of(config)["train"]
    draws = [
        Drawing(config).rng(split, structure).integers(2**62)
        for split in SPLITS.base
        for structure in structures
    ]
    assert len(set(draws)) == len(draws)
    assert all(a != b for a, b in pairwise(draws))
