"""Which structures are few walls apart, against comparing all of them."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labyrinth_core.world import Structure
from pipeline.inspection import Neighbourhood, near_twins


def draw(height: int, width: int, count: int, seed: int = 0) -> list[Structure]:
    """Return different structures, with many walls open here and there, so that some are near."""
    rng = np.random.default_rng(seed)
    drawn = Structure.sample(height, width, rng, open_walls=rng.uniform(0, 0.5))
    return list(dict.fromkeys(islice(drawn, count)))


def distances(of: list[Structure], among: list[Structure]) -> np.ndarray:
    """Return how many passages only one of two structures has, counted one by one."""
    sets = [set(structure.passages()) for structure in among]
    return np.array([[len(set(s.passages()) ^ other) for other in sets] for s in of])


SIZES = [(2, 2), (3, 3), (4, 4), (2, 7), (7, 2), (5, 6), (6, 9)]


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_the_nearest_is_the_one_that_comparing_all_finds(height, width):
    structures = draw(height, width, 120)
    of, among = structures[::2], structures[1::2]
    found = near_twins.nearest(near_twins.passage_table(of), near_twins.passage_table(among))
    apart = distances(of, among)
    assert found.walls.tolist() == apart.min(axis=1).tolist()
    assert found.which.tolist() == apart.argmin(axis=1).tolist()


def test_large_structures_have_a_nearest_one_too():
    structures = draw(60, 60, 4)
    found = near_twins.nearest(*map(near_twins.passage_table, (structures[:2], structures[2:])))
    assert found.walls.tolist() == distances(structures[:2], structures[2:]).min(axis=1).tolist()


@settings(max_examples=30)
@given(st.integers(0, 2**32), st.integers(1, 4), st.sampled_from(SIZES))
def test_a_neighbourhood_knows_who_is_near(seed, walls, size):
    structures = draw(*size, 40, seed)
    of, among = structures[::2], structures[1::2] or structures
    near = Neighbourhood(*size, walls, len(among))
    for structure in among:
        near.add(structure)
    expected = (distances(of, among).min(axis=1) <= walls).tolist()
    assert [near.is_near(structure) for structure in of] == expected


@pytest.mark.parametrize("held", [5, 3_000])
def test_near_twins_are_found_whatever_their_walls(held, monkeypatch):
    """Among few, with short keys, and among many, with long ones; and in many small steps."""
    rng = np.random.default_rng(3)
    among = near_twins.passage_table(draw(5, 5, held))
    of = among[np.arange(400) % held].copy()
    for number, row in enumerate(of):
        row[rng.choice(40, size=number % 6, replace=False)] ^= True
    expected = [(row != among).sum(axis=1).min() for row in of]
    assert near_twins.nearest(of, among).walls.tolist() == expected
    monkeypatch.setattr(near_twins, "HELD_PAIRS", 50)
    assert near_twins.nearest(of, among).walls.tolist() == expected


def test_where_all_pairs_are_too_many_what_is_near_is_found_all_the_same(monkeypatch):
    structures = draw(4, 4, 200)
    of, among = (
        near_twins.passage_table(structures[::2]),
        near_twins.passage_table(structures[1::2]),
    )
    whole = near_twins.nearest(of, among)
    monkeypatch.setattr(near_twins, "MOST_PAIRS", 0)
    cut = near_twins.nearest(of, among)
    near = whole.walls <= near_twins.JOINED_WALLS
    assert 0 < near.sum() < len(near)
    assert cut.walls.tolist() == np.where(near, whole.walls, near_twins.FAR).tolist()
    assert cut.which[near].tolist() == whole.which[near].tolist()
