"""The measures of shift, against counting rows one by one and SciPy."""

from __future__ import annotations

from collections import Counter
from itertools import chain

import numpy as np
import pytest
from scipy.spatial.distance import jensenshannon
from scipy.stats import wasserstein_distance

from labyrinth_core.data import SPLITS, Dataset
from labyrinth_core.language import parse
from labyrinth_core.world import Labyrinth, Solver, Structure
from pipeline.inspection import shift, statistics

PAIR = ("train", "s0_and_g")


@pytest.fixture(scope="module")
def dataset(build, tmp_path_factory):
    folder = tmp_path_factory.mktemp("measured")
    run = build(folder, size="3x4", labyrinths=6, solutions="all", random_steps=30)
    return run.folder


@pytest.fixture(scope="module")
def contents(dataset):
    parts = {split: [] for split in SPLITS.base}
    statistics.count_dataset(
        Dataset.at(dataset), keep=lambda split, content: parts[split].append(content)
    )
    return {split: statistics.Content.joined(of_split) for split, of_split in parts.items()}


def rows_of(dataset, split):
    """Return the labyrinth and the action, if any, and the agent's cell of each row."""
    rows = []
    for group in chain.from_iterable(file.episodes() for file in Dataset.at(dataset).files(split)):
        for text, actions, _ in group.each():
            labyrinth = parse(text)
            cells = [state.agent for state in labyrinth.replay(actions).states]
            rows += [(labyrinth, *row) for row in zip([*actions, -1], cells, strict=True)]
    return rows


def test_what_a_split_holds_is_what_its_rows_say(dataset, contents):
    for split in SPLITS.base:
        rows, content = rows_of(dataset, split), contents[split]
        assert list(content.labyrinths) == list(dict.fromkeys(labyrinth for labyrinth, *_ in rows))
        for number, labyrinth in enumerate(content.labyrinths):
            own = [(action, cell) for of, action, cell in rows if of == labyrinth]
            actions, cells = Counter(a for a, _ in own), Counter(c for _, c in own)
            assert content.actions[number].tolist() == [actions[action] for action in range(4)]
            assert content.visits[number].ravel().tolist() == [cells[cell] for cell in range(12)]
            assert content.moves[number] == len(Solver(labyrinth).shortest_routes()[0])


def columns_of(rows):
    """Return row, column and passages of each row, each from 0 to 1."""
    edges = [(c, c + 4) for c in range(8)] + [(c, c + 1) for c in range(12) if (c + 1) % 4]
    return np.array(
        [
            [cell // 4 / 2, cell % 4 / 3, *(edge in of.structure.passages() for edge in edges)]
            for of, _, cell in rows
        ],
        dtype=float,
    ).T


def test_the_distances_are_those_of_the_rows(dataset, contents):
    shifts = {s.measure: s for s in shift.compare(contents, [PAIR], seed=0)}
    assert list(shifts) == list(shift.MEASURES)
    a, b = (rows_of(dataset, split) for split in PAIR)
    taken = [Counter(action for _, action, _ in rows) for rows in (a, b)]
    shares = [[counts[action] for action in range(4)] for counts in taken]
    assert shifts["actions"].distance == pytest.approx(jensenshannon(*shares, base=2))
    each = [wasserstein_distance(x, y) for x, y in zip(columns_of(a), columns_of(b), strict=True)]
    assert shifts["trajectories"].distance == pytest.approx(np.mean(each[:2]))
    assert shifts["states"].distance == pytest.approx(np.mean(each))


def numbers_of(labyrinth: Labyrinth):
    """Return moves, junctions and loops of a labyrinth."""
    ends = Counter(cell for pair in labyrinth.structure.passages() for cell in pair)
    passages = sum(ends.values()) // 2
    return (
        len(Solver(labyrinth).shortest_routes()[0]),
        sum(count >= 3 for count in ends.values()),
        passages - labyrinth.structure.cells + 1,
    )


def test_lengths_branches_and_loops_are_those_of_the_labyrinths(contents):
    shifts = {s.measure: s for s in shift.compare(contents, [("train", "test")], 0)}
    a, b = (np.array(list(map(numbers_of, contents[s].labyrinths))) for s in ("train", "test"))
    for column, name in enumerate(["route length", "branching", "loops"]):
        x, y = a[:, column], b[:, column]
        assert shifts[name].distance == pytest.approx(wasserstein_distance(x, y))
        deviation = np.sqrt((x.var(ddof=1) + y.var(ddof=1)) / 2)
        assert shifts[name].effect == pytest.approx((y.mean() - x.mean()) / deviation)
        assert shifts[name].labyrinths == (6, 6)


def content_of(structures):
    """Return a split with the first shortest route of each labyrinth."""
    labyrinths = [Labyrinth(s, 0, s.cells - 1) for s in structures]
    routes = [Solver(labyrinth).shortest_routes()[0] for labyrinth in labyrinths]
    visits = np.zeros((len(labyrinths), 25), np.int64)
    for number, (labyrinth, route) in enumerate(zip(labyrinths, routes, strict=True)):
        for state in labyrinth.replay(route).states:
            visits[number, state.agent] += 1
    actions = np.array([np.bincount(route, minlength=4) for route in routes])
    moves = np.array(list(map(len, routes)))
    return statistics.Content(tuple(labyrinths), moves, actions, visits.reshape(-1, 5, 5))


def drawn(count, seed, open_walls):
    rng = np.random.default_rng(seed)
    structures = Structure.sample(5, 5, rng, open_walls=open_walls)
    return content_of([next(structures) for _ in range(count)])


def test_walls_opened_in_one_split_only_are_a_shift_and_otherwise_there_is_none():
    contents = {"train": drawn(60, 0, 0.05), "same": drawn(60, 1, 0.05), "other": drawn(60, 2, 0.5)}
    shifts = shift.compare(contents, [("train", "same"), ("train", "other")], seed=3)
    of = {(s.second, s.measure): s for s in shifts}
    assert all(of["same", measure].corrected > 0.05 for measure in shift.MEASURES)
    for measure in ("states", "branching", "loops", "route length"):
        assert of["other", measure].p_value == 0.001
        assert of["other", measure].corrected == pytest.approx(0.012)
    assert of["other", "loops"].effect > 2
    assert of["other", "route length"].effect < 0


def test_the_same_structures_are_exchanged_with_themselves_only():
    """So a small change that all of them share is seen, among labyrinths that differ more."""
    structures = [labyrinth.structure for labyrinth in drawn(16, 5, 0.1).labyrinths]
    whole = content_of(structures)
    longer = statistics.Content(whole.labyrinths, whole.moves + 1, whole.actions, whole.visits)
    shuffled = statistics.Content(
        whole.labyrinths[::-1], longer.moves[::-1], whole.actions, whole.visits
    )
    contents = {"train": whole, "longer": longer, "shuffled": shuffled}
    paired, apart = (
        {s.measure: s for s in shift.compare(contents, [("train", other)], seed=0)}["route length"]
        for other in ("longer", "shuffled")
    )
    assert paired.distance == apart.distance == 1
    assert paired.p_value == 0.001
    assert apart.p_value > 0.01


def test_the_same_seed_gives_the_same_p_values_and_json_has_no_infinity(contents):
    pairs = [("train", "test"), PAIR]
    first = shift.compare(contents, pairs, seed=1)
    assert first == shift.compare(contents, pairs, seed=1)
    infinite = first[0].__class__(**vars(first[0]) | {"effect": np.inf})
    assert infinite.to_json()["effect"] is None
