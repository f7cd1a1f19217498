"""Random structures: how many there are, and that each comes up as often as it should."""

from collections import Counter
from itertools import islice

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.brute_force import (
    all_structures,
    chi_square,
    is_connected,
    passages_of,
)

from labyrinth_core.world import ALGORITHMS, Structure, default_open_walls

seeds = st.integers(0, 2**64 - 1)
sides = st.integers(2, 7)
algorithms = st.sampled_from(sorted(ALGORITHMS))


def draw(count, height, width, seed, **options):
    rng = np.random.default_rng(seed)
    return list(islice(Structure.sample(height, width, rng, **options), count))


def connected(height, width):
    return [
        structure
        for structure in all_structures(height, width)
        if is_connected(height, width, passages_of(structure))
    ]


def spanning_trees(height, width):
    """Return the connected structures with one passage less than cells, the fewest possible."""
    passages = height * width - 1
    return [each for each in connected(height, width) if len(passages_of(each)) == passages]


# What every algorithm gives.


@given(sides, sides, seeds, algorithms, st.sampled_from([None, 0, 0.2, 1]))
def test_every_sampled_structure_is_connected(height, width, seed, algorithm, open_walls):
    for structure in draw(3, height, width, seed, algorithm=algorithm, open_walls=open_walls):
        assert (structure.height, structure.width) == (height, width)
        assert is_connected(height, width, passages_of(structure))
        if open_walls == 0:
            assert len(passages_of(structure)) == height * width - 1
        if open_walls == 1:
            assert structure == Structure.without_walls(height, width)


@pytest.mark.parametrize(
    ("algorithm", "structure_id"),
    [
        ("wilson", "2818f0e5a52c84c6"),
        ("depth_first", "08adb12e701d8d24"),
        ("kruskal", "2cbd76d8c418c783"),
        ("prim", "600664f1b373113f"),
    ],
)
def test_a_seed_gives_the_same_structure_on_every_machine(algorithm, structure_id):
    structure = next(Structure.sample(5, 5, np.random.default_rng(0), algorithm=algorithm))
    assert structure.structure_id == structure_id


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", sorted(ALGORITHMS))
@pytest.mark.parametrize(("height", "width"), [(100, 100), (2, 1000), (1000, 2)])
def test_large_and_long_structures_are_drawn_without_recursion(algorithm, height, width):
    structure = draw(1, height, width, 0, algorithm=algorithm, open_walls=0)[0]
    assert structure.is_connected
    assert structure.up.bit_count() + structure.right.bit_count() == height * width - 1


# How often each comes up.


@pytest.mark.slow
@pytest.mark.parametrize(("height", "width", "trees"), [(3, 3, 192), (2, 4, 56), (4, 2, 56)])
def test_wilson_gives_every_tree_the_same_probability(height, width, trees):
    counts = Counter(draw(100 * trees, height, width, 11, algorithm="wilson", open_walls=0))
    assert set(counts) == set(spanning_trees(height, width))
    assert len(counts) == trees
    assert chi_square(counts.values(), [100.0] * trees) < 5


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", sorted(ALGORITHMS))
def test_every_algorithm_can_give_every_tree_of_two_by_two(algorithm):
    counts = Counter(draw(4000, 2, 2, 12, algorithm=algorithm, open_walls=0))
    assert set(counts) == set(spanning_trees(2, 2))
    assert chi_square(counts.values(), [1000.0] * 4) < 5


@pytest.mark.slow
def test_the_default_sampler_reaches_every_structure_as_often_as_it_should():
    trees = [passages_of(tree) for tree in spanning_trees(3, 3)]
    opened, draws = default_open_walls(3, 3), 100_000
    expected = {}
    for structure in connected(3, 3):
        passages = passages_of(structure)
        within = sum(tree <= passages for tree in trees)
        extra, walls = len(passages) - 8, 12 - len(passages)
        chance = within / len(trees) * opened**extra * (1 - opened) ** walls
        expected[structure] = chance * draws
    assert sum(expected.values()) == pytest.approx(draws)
    counts = Counter(draw(draws, 3, 3, 13))
    assert set(counts) == set(expected)
    assert chi_square([counts[each] for each in expected], expected.values()) < 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("height", "width", "share"),
    [(3, 3, 0.12), (4, 4, 0.09), (5, 5, 0.08), (3, 4, 0.08), (2, 8, 0.08), (10, 10, 0.08)],
)
def test_as_many_walls_are_open_as_in_the_published_sets(height, width, share):
    assert default_open_walls(height, width) == share
    drawn = draw(3000, height, width, 14)
    walls = height * (width - 1) + width * (height - 1) - (height * width - 1)
    opened = [len(passages_of(each)) - (height * width - 1) for each in drawn]
    spread = (share * (1 - share) / (walls * len(drawn))) ** 0.5
    assert abs(np.mean(opened) / walls - share) < 5 * spread


# What is refused.


def test_an_unknown_algorithm_is_refused_with_the_known_ones():
    message = "^sampler=magic: choose one of wilson, depth_first, kruskal, prim$"
    with pytest.raises(ValueError, match=message):
        next(Structure.sample(3, 3, np.random.default_rng(0), algorithm="magic"))


@pytest.mark.parametrize("open_walls", [-0.1, 1.1, float("nan"), float("inf")])
def test_a_share_that_is_no_probability_is_refused(open_walls):
    with pytest.raises(
        ValueError, match=f"^open_walls={open_walls}: give a probability from 0 to 1"
    ):
        next(Structure.sample(3, 3, np.random.default_rng(0), open_walls=open_walls))
