"""Structures by the thousand: the same law as one at a time, or the very same structures."""

from collections import Counter
from itertools import islice

import numpy as np
import pytest
from brute_force import chi_square, is_connected, passages_of
from hypothesis import given
from hypothesis import strategies as st

from labyrinth_core.world.batch_sampling import sample_each, sample_many
from labyrinth_core.world.labyrinth import Structure
from labyrinth_core.world.sampling import ALGORITHMS, sample_structure, sample_structures

seeds = st.integers(0, 2**64 - 1)
sides = st.integers(2, 9)
algorithms = st.sampled_from(sorted(ALGORITHMS))


def draw(height, width, count, seed, **options):
    structures = sample_many(height, width, count, np.random.default_rng(seed), **options)
    return [structures[place] for place in range(count)]


@given(sides, sides, seeds, algorithms)
def test_trees_are_connected_and_have_no_loop(height, width, seed, algorithm):
    for tree in draw(height, width, 5, seed, algorithm=algorithm, open_walls=0):
        assert (tree.height, tree.width) == (height, width)
        assert len(passages_of(tree)) == height * width - 1
        assert is_connected(height, width, passages_of(tree))


@pytest.mark.parametrize("algorithm", sorted(ALGORITHMS))
def test_trees_come_up_as_often_as_when_drawn_one_at_a_time(algorithm):
    count, options = 12_000, {"algorithm": algorithm, "open_walls": 0}
    together = Counter(draw(3, 3, count, 1, **options))
    singly = Counter(islice(sample_structures(3, 3, np.random.default_rng(2), **options), count))
    trees = together | singly
    both = [(together[tree] + singly[tree]) / 2 for tree in trees]
    # The difference of two counts varies twice as much as a count does.
    apart = [
        mean + (together[tree] - mean) * 2**0.5 for mean, tree in zip(both, trees, strict=True)
    ]
    assert abs(chi_square(apart, both)) < 5


def test_wilson_gives_every_tree_the_same_probability_and_the_others_do_not():
    for algorithm in ALGORITHMS:
        counts = Counter(draw(3, 3, 19_200, 3, algorithm=algorithm, open_walls=0))
        uneven = chi_square([*counts.values(), *[0] * (192 - len(counts))], [100.0] * 192)
        assert (abs(uneven) < 5) == (algorithm == "wilson"), algorithm


@pytest.mark.parametrize("algorithm", sorted(ALGORITHMS))
def test_walls_are_opened_with_the_probability_that_is_given(algorithm):
    trees = sample_many(6, 4, 2_000, np.random.default_rng(4), algorithm=algorithm, open_walls=0)
    assert len(trees) == 2_000
    opened = draw(6, 4, 2_000, 4, algorithm=algorithm, open_walls=0.3)
    share = np.mean([len(passages_of(each)) - 23 for each in opened]) / (38 - 23)
    assert share == pytest.approx(0.3, abs=5 * (0.3 * 0.7 / (15 * 2_000)) ** 0.5)
    everything = draw(6, 4, 2, 4, algorithm=algorithm, open_walls=1)
    assert everything == [trees.without_walls()] * 2


@given(sides, sides, seeds)
def test_moves_are_those_of_each_structure(height, width, seed):
    structures = sample_many(height, width, 4, np.random.default_rng(seed))
    for place, moves in enumerate(structures.moves().tolist()):
        assert list(map(tuple, moves)) == structures[place].moves


@given(algorithms, seeds)
def test_the_same_seed_gives_the_same_structures(algorithm, seed):
    first, second = (draw(5, 6, 3, seed, algorithm=algorithm) for _ in "ab")
    assert first == second


def test_what_is_refused_is_what_one_at_a_time_refuses():
    with pytest.raises(ValueError, match=r"^sampler=magic: choose one of wilson"):
        draw(3, 3, 1, 0, algorithm="magic")
    with pytest.raises(ValueError, match=r"^open_walls=2: give a probability from 0 to 1"):
        draw(3, 3, 1, 0, open_walls=2)


# From a generator each.


@pytest.mark.parametrize("shape", [(2, 2), (3, 3), (5, 5), (4, 7), (8, 8)])
def test_each_generator_gives_the_structure_that_it_gives_alone(shape):
    generators, alone = ([np.random.default_rng(seed) for seed in range(400)] for _ in "ab")
    drawn = sample_each(*shape, generators)
    assert len(drawn.numbers) > 300
    for place, number in enumerate(drawn.numbers.tolist()):
        assert drawn.structures[place] == sample_structure(*shape, alone[number])
        assert drawn.before[place] == np.random.default_rng(number).bit_generator.state
    assert len(drawn.numbers) < 400 or shape < (4, 4), "some walks are long"
    for generator, same in zip(generators, alone, strict=True):
        assert generator.bytes(8) == same.bytes(8)


def test_generators_that_are_read_otherwise_are_left_alone():
    twister = np.random.Generator(np.random.MT19937(0))
    halfway = np.random.default_rng(0)
    halfway.integers(9, dtype=np.uint32)
    before = halfway.bit_generator.state
    drawn = sample_each(4, 4, [twister, np.random.default_rng(5), halfway])
    assert drawn.numbers.tolist() == [1]
    assert halfway.bit_generator.state == before
    assert twister.random() == np.random.Generator(np.random.MT19937(0)).random()
    assert isinstance(drawn.structures[0], Structure)
