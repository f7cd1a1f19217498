"""Tables by the thousand: those of each labyrinth alone."""

from dataclasses import fields

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from labyrinth_core.world.batch_sampling import sample_many
from labyrinth_core.world.batch_tables import tabulate_many
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.state_tables import LabyrinthTables, tabulate


@st.composite
def batches(draw):
    height, width = draw(st.integers(2, 7)), draw(st.integers(2, 7))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    walls = draw(st.sampled_from([0, 0.1, 0.5, 1]))
    start, goal = rng.choice(height * width, 2, replace=False).tolist()
    return sample_many(height, width, 4, rng, open_walls=walls), start, goal


@given(batches(), st.booleans())
def test_tables_are_those_of_each_labyrinth(batch, normalised):
    structures, start, goal = batch
    together = tabulate_many(structures, start, goal, normalised=normalised)
    for place in range(len(structures)):
        alone = tabulate(Labyrinth(structures[place], start, goal), normalised=normalised)
        assert alone.initial == together.start
        for name in [each.name for each in fields(LabyrinthTables)][2:]:
            ours, theirs = getattr(together, name)[place], getattr(alone, name)
            assert ours.dtype == theirs.dtype, name
            np.testing.assert_array_equal(ours, theirs, name)


@given(batches())
def test_routes_lead_to_the_goal_and_none_is_shorter(batch):
    structures, start, goal = batch
    tables = tabulate_many(structures, start, goal)
    for place, route in enumerate(tables.shortest_routes().tolist()):
        actions = [action for action in route if action >= 0]
        assert route == actions + [-1] * (len(route) - len(actions))
        assert len(actions) == structures[place].distances(goal)[start]
        cell = start
        for action in actions:
            cell = structures[place].moves[cell][action]
        assert cell == goal


def test_no_structures_have_no_tables():
    tables = tabulate_many(sample_many(3, 4, 0, np.random.default_rng(0)), 0, 11)
    assert tables.transitions.shape == (0, 12, 4)
    assert tables.shortest_routes().shape == (0, 0)
