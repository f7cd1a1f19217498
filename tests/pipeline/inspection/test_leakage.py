"""The certificate of leakage, against brute force and leaks made by hand."""

from __future__ import annotations

from itertools import combinations, islice

import numpy as np
import pytest

from labyrinth_core.language.text import labyrinth_id
from labyrinth_core.world.labyrinth import Labyrinth, Structure
from labyrinth_core.world.sampling import sample_structures
from labyrinth_core.world.solver import shortest_routes
from pipeline.inspection.leakage import find_leakage


def cornered(structures):
    return [Labyrinth(s, 0, s.cells - 1) for s in structures]


def all_connected_3x3():
    edges = [(c, c + 1) for c in range(9) if (c + 1) % 3] + [(c, c + 3) for c in range(6)]
    for count in range(8, 13):
        for passages in combinations(edges, count):
            structure = Structure.from_passages(3, 3, passages)
            if structure.is_connected:
                yield structure


def drawn(size, count, seed):
    found = dict.fromkeys(islice(sample_structures(*size, np.random.default_rng(seed)), count))
    rng = np.random.default_rng(seed)
    return [list(found)[place] for place in rng.permutation(len(found))]


EXAMPLES = {
    "all of 3x3": list(all_connected_3x3()),
    "4x4": drawn((4, 4), 400, 1),
    "2x4": drawn((2, 4), 400, 2),
}


@pytest.mark.slow
@pytest.mark.parametrize("structures", EXAMPLES.values(), ids=EXAMPLES)
def test_the_counts_are_those_of_brute_force(structures):
    third = len(structures) // 3
    splits = {
        "train": cornered(structures[:third]),
        "test": cornered(structures[third - 2 : 2 * third]),  # Two are in both.
        "more": cornered(structures[2 * third :]),
    }
    leakage = find_leakage(splits)
    pairs = [each.pair for each in leakage.pairs]
    assert [(pair.first, pair.second) for pair in pairs] == list(combinations(splits, 2))
    for close in leakage.pairs:
        assert_as_brute_force(close, splits[close.pair.first], splits[close.pair.second])
    assert len(pairs[0].equal) == 2


def assert_as_brute_force(close, first, second):
    ids = {labyrinth_id(labyrinth): labyrinth for labyrinth in [*first, *second]}
    passages = {number: set(of.structure.passages()) for number, of in ids.items()}
    routes = {number: set(map(tuple, shortest_routes(of))) for number, of in ids.items()}
    turned = {number: set(of.structure.symmetries()) for number, of in ids.items()}
    keeping = {number: {of.structure} for number, of in ids.items()}
    for number, of in ids.items():
        if of.structure.height == of.structure.width:  # Only then it keeps the corners.
            keeping[number].add(of.structure.transposed())
    train = [labyrinth_id(labyrinth) for labyrinth in first]
    others = [labyrinth_id(labyrinth) for labyrinth in second]

    def with_counterpart(alike):
        """Return the first of train that is like each, for those that are like any."""
        pairs = ((other, next((t for t in train if alike(t, other)), None)) for other in others)
        return {other: found for other, found in pairs if found}

    assert close.pair.equal == with_counterpart(lambda t, o: ids[t].structure == ids[o].structure)
    for found, images in ((close.pair.mirrored, keeping), (close.symmetric, turned)):
        assert set(found) == set(with_counterpart(lambda t, o, i=images: ids[t].structure in i[o]))
        assert all(ids[t].structure in images[o] for o, t in found.items())
    assert close.same_route == with_counterpart(lambda t, o: routes[t] & routes[o])
    for walls in (1, 2, 3):
        assert close.within(walls) == len(
            with_counterpart(lambda t, o, most=walls: len(passages[t] ^ passages[o]) <= most)
        )
    assert set(close.nearest) == set(others)
    for other, (number, walls) in close.nearest.items():
        assert walls == min(len(passages[t] ^ passages[other]) for t in train)
        assert walls == len(passages[number] ^ passages[other])


def test_of_structures_alone_all_images_are_mirror_images_and_there_are_no_routes():
    structures = EXAMPLES["all of 3x3"]
    halves = {"train": structures[:200], "test": structures[200:]}
    (alone,) = find_leakage(halves).pairs
    (close,) = find_leakage({split: cornered(half) for split, half in halves.items()}).pairs
    ids = {labyrinth_id(each): each.structure.structure_id for each in cornered(structures)}
    assert alone.symmetric == {ids[other]: ids[one] for other, one in close.symmetric.items()}
    assert alone.pair.mirrored == alone.symmetric
    assert len(alone.symmetric) > len(close.pair.mirrored)
    near = {ids[other]: (ids[one], walls) for other, (one, walls) in close.nearest.items()}
    assert alone.nearest == near
    assert alone.same_route == {}


TREE = [(0, 1), (1, 4), (3, 4), (3, 6), (6, 7), (4, 5), (2, 5), (5, 8)]
TRAIN = Labyrinth(Structure.from_passages(3, 3, TREE), 0, 8)
"""A labyrinth that no symmetry of the square leaves as it is."""


def leak_of(other: Labyrinth):
    (close,) = find_leakage({"train": [TRAIN], "test": [other]}).pairs
    assert set(close.nearest) <= {labyrinth_id(other)}
    return close


def witness(other: Labyrinth):
    return {labyrinth_id(other): labyrinth_id(TRAIN)}


def with_structure(structure: Structure, start: int = 0, goal: int = 8) -> Labyrinth:
    return Labyrinth(structure, start, goal)


def test_a_structure_with_another_start_is_the_same():
    other = with_structure(TRAIN.structure, 1, 8)
    close = leak_of(other)
    assert close.pair.equal == close.pair.mirrored == close.symmetric == witness(other)
    assert close.nearest == {labyrinth_id(other): (labyrinth_id(TRAIN), 0)}
    assert close.same_route == {}


def test_a_mirror_image_that_keeps_start_and_goal_is_found():
    other = with_structure(TRAIN.structure.transposed())
    close = leak_of(other)
    assert close.pair.equal == {}
    assert close.pair.mirrored == close.symmetric == witness(other)


def test_a_mirror_image_that_moves_start_and_goal_along_is_found():
    image = TRAIN.structure.mirrored()
    along, not_along = with_structure(image, 2, 6), with_structure(image, 0, 8)
    assert leak_of(along).pair.mirrored == witness(along)
    assert leak_of(not_along).pair.mirrored == {}
    assert leak_of(not_along).symmetric == witness(not_along)


def test_a_wall_more_or_less_is_a_near_twin_and_a_second_one_makes_it_two():
    assert len(set(TRAIN.structure.symmetries())) == 8
    for count in (1, 2):
        other = with_structure(Structure.from_passages(3, 3, [*TREE, *[(1, 2), (4, 7)][:count]]))
        close = leak_of(other)
        assert close.nearest == {labyrinth_id(other): (labyrinth_id(TRAIN), count)}
        assert [close.within(walls) for walls in (1, 2, 3)] == [count == 1, True, True]
        assert close.symmetric == {}


def test_an_optimal_route_in_common_is_found_in_structures_that_are_far_apart():
    tree = [(0, 1), (1, 4), (4, 5), (5, 8), (0, 3), (1, 2), (7, 8), (6, 7)]
    other = with_structure(Structure.from_passages(3, 3, tree))
    close = leak_of(other)
    assert close.same_route == witness(other)
    assert close.spread(1) == "6, 6"
    assert close.symmetric == {}


def test_labyrinths_of_other_sizes_have_nothing_in_common_but_what_is_turned():
    (wide,) = drawn((2, 3), 1, 0)
    tall = wide.transposed()
    splits = {"train": cornered([wide]), "test": cornered([tall, TRAIN.structure])}
    (close,) = find_leakage(splits).pairs
    assert close.pair.equal == close.nearest == close.same_route == {}
    assert len(close.symmetric) == 1
    assert close.spread(2) == "far, far"


def test_labyrinths_that_are_repeated_or_strange_are_counted():
    a, b, c = (with_structure(s) for s in drawn((3, 3), 9, 0)[:3])
    moved = with_structure(a.structure, 0, 5)
    leakage = find_leakage({"s0": [moved, c], "test": [b], "train": [a, moved, a]})
    certificate = leakage.certificate
    assert certificate.labyrinths == {"train": 2, "test": 1, "s0": 2}
    assert certificate.repeated == {"train": 1, "test": 0, "s0": 0}
    assert certificate.strangers == {"s0": [labyrinth_id(c)]}
    assert [(pair.first, pair.second) for pair in certificate.pairs] == [("train", "test")]


def test_routes_that_are_too_many_to_compare_are_counted():
    whole = with_structure(
        Structure.from_passages(
            3, 3, [(c, c + 1) for c in range(9) if (c + 1) % 3] + [(c, c + 3) for c in range(6)]
        )
    )
    assert len(shortest_routes(whole)) == 6
    assert find_leakage({"train": [TRAIN], "test": [whole]}, most_routes=5).cut == 1
