"""Keys of structures that are the same when turned, against the symmetries of the core."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from labyrinth_core.world.sampling import sample_structures
from pipeline.inspection.near_twins import passage_table
from pipeline.inspection.symmetry import canonical_keys


def keys_of(structures, cells=None):
    """Return the key of each structure, whatever its size."""
    return [
        canonical_keys(s.height, s.width, passage_table([s]), cells and np.array([cells[number]]))[
            0
        ]
        for number, s in enumerate(structures)
    ]


@pytest.mark.parametrize(("height", "width"), [(2, 2), (3, 3), (5, 5), (2, 4), (6, 3)])
def test_all_eight_images_share_a_key_and_no_other_structure_does(height, width):
    drawn = islice(sample_structures(height, width, np.random.default_rng(1)), 60)
    owners = {}
    for structure in drawn:
        images = structure.symmetries()
        (key,) = set(keys_of(images))
        assert owners.setdefault(key, set(images)) == set(images)
    assert len(owners) > 1


def test_a_table_gives_the_keys_that_its_rows_give_alone():
    structures = list(islice(sample_structures(4, 4, np.random.default_rng(2)), 50))
    assert canonical_keys(4, 4, passage_table(structures)) == keys_of(structures)


def test_with_cells_marked_only_what_maps_them_on_one_another_is_the_same():
    structure = next(sample_structures(4, 4, np.random.default_rng(5)))
    image = structure.transposed()
    ends = [(1, 14), (4, 11)]  # Row and column exchanged.
    key, mirrored = keys_of([structure, image], ends)
    assert key == mirrored
    assert keys_of([image], [(1, 14)]) != [key]
    assert keys_of([structure], [(14, 1)]) != [key]  # The start is no goal.
    assert keys_of([image]) == keys_of([structure])
