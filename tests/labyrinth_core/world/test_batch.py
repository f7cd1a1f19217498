"""Tables of one labyrinth, and of many at once: the same."""

from dataclasses import fields

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.strategies import labyrinths

from labyrinth_core.world import BatchSampler, Labyrinth, Tables


@given(labyrinths())
def test_rewards_and_ends_are_those_of_the_dynamics(labyrinth):
    tables = Tables.of(labyrinth)
    for number, (paid, ends) in enumerate(zip(tables.rewards, tables.terminal, strict=True)):
        state = labyrinth.state_at(number)
        assert (paid, ends) == (labyrinth.reward(state), labyrinth.is_terminal(state))


@given(st.integers(2, 7), st.integers(2, 7), st.integers(0, 2**32), st.booleans())
def test_tables_of_many_are_those_of_each_labyrinth(height, width, seed, normalised):
    rng = np.random.default_rng(seed)
    start, goal = rng.choice(height * width, 2, replace=False).tolist()
    structures = BatchSampler(height, width).sample(rng.spawn(4)).structures
    together = Tables.of_many(structures, start, goal, normalised=normalised)
    for place in range(len(structures)):
        alone = Tables.of(Labyrinth(structures[place], start, goal), normalised=normalised)
        assert alone.initial == together.initial
        for name in [each.name for each in fields(Tables)][1:]:
            ours, theirs = getattr(together, name)[place], getattr(alone, name)
            assert ours.dtype == theirs.dtype, name
            np.testing.assert_array_equal(ours, theirs, name)
