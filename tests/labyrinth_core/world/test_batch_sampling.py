"""Structures drawn together: those that each generator draws alone."""

import numpy as np
import pytest

from labyrinth_core.world import BatchSampler, Structure


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(2, 2), (3, 3), (5, 5), (4, 7), (8, 8)])
def test_each_generator_gives_the_structure_that_it_gives_alone(shape):
    generators, alone = ([np.random.default_rng(seed) for seed in range(400)] for _ in "ab")
    drawn = BatchSampler(*shape).sample(generators)
    assert len(drawn.numbers) > 300
    for place, number in enumerate(drawn.numbers.tolist()):
        assert drawn.structures[place] == next(Structure.sample(*shape, alone[number]))
        assert drawn.before[place] == np.random.default_rng(number).bit_generator.state
    assert len(drawn.numbers) < 400 or shape < (4, 4), "some walks are long"
    for generator, same in zip(generators, alone, strict=True):
        assert generator.bytes(8) == same.bytes(8)


def test_generators_that_are_read_otherwise_are_left_alone():
    twister = np.random.Generator(np.random.MT19937(0))
    halfway = np.random.default_rng(0)
    halfway.integers(9, dtype=np.uint32)
    before = halfway.bit_generator.state
    drawn = BatchSampler(4, 4).sample([twister, np.random.default_rng(5), halfway])
    assert drawn.numbers.tolist() == [1]
    assert halfway.bit_generator.state == before
    assert twister.random() == np.random.Generator(np.random.MT19937(0)).random()
