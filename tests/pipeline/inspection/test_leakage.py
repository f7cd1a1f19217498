"""The certificate of leakage, against brute force and leaks made by hand."""

from __future__ import annotations

from itertools import combinations, islice
from statistics import median

import numpy as np
import pytest
from support.brute_force import all_structures

from labyrinth_core.language import labyrinth_id
from labyrinth_core.world import Labyrinth, Solver, Structure
from pipeline.inspection import find_leakage, leakage


def cornered(structures):
    return [Labyrinth(s, 0, s.cells - 1) for s in structures]


def from_corner_to_corner(structures, seed):
    """Return labyrinths, each of which leads from one of the four corners to another one."""
    rng = np.random.default_rng(seed)
    corners = [(0, s.width - 1, s.cells - s.width, s.cells - 1) for s in structures]
    ends = [rng.permutation(of)[:2].tolist() for of in corners]
    return [Labyrinth(s, *of) for s, of in zip(structures, ends, strict=True)]


def drawn(size, count, seed):
    found = dict.fromkeys(islice(Structure.sample(*size, np.random.default_rng(seed)), count))
    rng = np.random.default_rng(seed)
    return [list(found)[place] for place in rng.permutation(len(found))]


EXAMPLES = {
    "all of 3x3": [each for each in all_structures(3, 3) if each.is_connected],
    "4x4": drawn((4, 4), 400, 1),
    "2x4": drawn((2, 4), 400, 2),
}


@pytest.mark.slow
@pytest.mark.parametrize("structures", EXAMPLES.values(), ids=EXAMPLES)
def test_the_counts_are_those_of_brute_force(structures):
    third = len(structures) // 3
    first = from_corner_to_corner(structures[:third], 1)
    second = from_corner_to_corner(structures[third : 2 * third], 2)
    moved = from_corner_to_corner(structures[:9], 3)  # The same structures, with other ends.
    turned = [
        Labyrinth(Structure.from_passages(*shape, map(tuple, passages)), *ends)
        for shape, passages, *along in images_of(first[20])[1:]
        for ends in (along, along[::-1])
        if shape == (first[20].structure.height, first[20].structure.width)
    ]
    splits = {
        "train": first,
        "test": [first[10], *moved, *turned, *second],
        "more": from_corner_to_corner(structures[2 * third :], 4),
    }
    found = find_leakage(splits)
    pairs = [each.pair for each in found.pairs]
    assert [(pair.first, pair.second) for pair in pairs] == list(combinations(splits, 2))
    for close in found.pairs:
        assert_as_brute_force(close, splits[close.pair.first], splits[close.pair.second])
    assert len(pairs[0].equal) >= 10
    assert len(found.pairs[0].symmetric) > len(pairs[0].mirrored) > len(pairs[0].equal)


def images_of(labyrinth):
    """Return passages, start and goal of all rotations and reflections of a labyrinth."""
    structure = labyrinth.structure
    cells = np.arange(structure.cells).reshape(structure.height, structure.width)
    images = []
    for turned in (np.rot90(cells, turns) for turns in range(4)):
        for image in (turned, turned.T):
            place = {cell: number for number, cell in enumerate(image.ravel().tolist())}
            pairs = ((place[one], place[other]) for one, other in structure.passages())
            passages = frozenset(map(frozenset, pairs))
            images.append((image.shape, passages, place[labyrinth.start], place[labyrinth.goal]))
    return images


def assert_as_brute_force(close, first, second):
    ids = {labyrinth_id(labyrinth): labyrinth for labyrinth in [*first, *second]}
    passages = {number: set(of.structure.passages()) for number, of in ids.items()}
    routes = {
        number: {(of.start, *route) for route in Solver(of).shortest_routes()}
        for number, of in ids.items()
    }
    along = {number: images_of(of) for number, of in ids.items()}
    turned = {number: [image[:2] for image in images] for number, images in along.items()}
    train = [labyrinth_id(labyrinth) for labyrinth in first]
    others = [labyrinth_id(labyrinth) for labyrinth in second]

    def with_counterpart(alike):
        """Return the first of train that is like each, for those that are like any."""
        pairs = ((other, next((t for t in train if alike(t, other)), None)) for other in others)
        return {other: found for other, found in pairs if found}

    def same(t, o):
        return ids[t].structure == ids[o].structure

    assert close.pair.equal == with_counterpart(same)
    for found, images in ((close.pair.mirrored, along), (close.symmetric, turned)):

        def alike(t, o, images=images):
            return same(t, o) or images[t][0] in images[o]

        assert set(found) == set(with_counterpart(alike))
        assert all(alike(t, o) for o, t in found.items())
    assert close.same_route == with_counterpart(lambda t, o: routes[t] & routes[o])
    for walls in (1, 2, 3):
        assert close.within(walls) == len(
            with_counterpart(lambda t, o, most=walls: len(passages[t] ^ passages[o]) <= most)
        )
    assert set(close.nearest) == set(others)
    for other, (number, walls) in close.nearest.items():
        assert walls == min(len(passages[t] ^ passages[other]) for t in train)
        assert walls == len(passages[number] ^ passages[other])
    apart = [walls for _, walls in close.nearest.values()]
    assert close.spread(len(others)) == f"{min(apart)}, {median(apart):g}"


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


def test_labyrinths_of_other_sizes_have_nothing_in_common_but_what_is_turned():
    (wide,) = drawn((2, 3), 1, 0)
    tall = wide.transposed()
    other = EXAMPLES["all of 3x3"][0]
    splits = {"train": cornered([wide]), "test": cornered([tall, other])}
    (close,) = find_leakage(splits).pairs
    assert close.pair.equal == close.nearest == close.same_route == {}
    assert len(close.symmetric) == 1
    assert close.spread(2) == "far, far"


def test_labyrinths_that_are_repeated_or_strange_are_counted():
    a, b, c = cornered(drawn((3, 3), 9, 0)[:3])
    moved = Labyrinth(a.structure, 0, 5)
    certificate = find_leakage({"s0": [moved, c], "test": [b], "train": [a, moved, a]}).certificate
    assert certificate.labyrinths == {"train": 2, "test": 1, "s0": 2}
    assert certificate.repeated == {"train": 2, "test": 0, "s0": 0}
    assert certificate.strangers == {"s0": [labyrinth_id(c)]}
    assert [(pair.first, pair.second) for pair in certificate.pairs] == [("train", "test")]


def test_routes_that_are_too_many_to_compare_are_counted(monkeypatch):
    monkeypatch.setattr(leakage, "ROUTES", 5)
    few, whole = cornered([EXAMPLES["all of 3x3"][0], Structure.without_walls(3, 3)])
    assert len(Solver(whole).shortest_routes()) == 6
    assert find_leakage({"train": [few], "test": [whole]}).cut == 1
