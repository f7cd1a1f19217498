"""The optimistic replanner: what it knows is what it has seen, and memory is what it needs."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.labyrinths_of_datasets import CONFIGS
from support.strategies import connected_structures

from labyrinth_core import evaluate, load_arrays
from labyrinth_core.evaluation import Description, Player, PolicyError
from labyrinth_core.evaluation.replanner import Replanner
from labyrinth_core.pictures import ObservationSpec
from labyrinth_core.world import Labyrinth, State, Structure, Task

CONFIG = CONFIGS[Task.PARTIAL_OBSERVABILITY]


def planned(labyrinth, agent, seen):
    """Return the first action of a shortest route in which unseen passages are open."""
    size = labyrinth.structure.height, labyrinth.structure.width
    known = {*labyrinth.structure.passages()}
    hoped = Structure.from_passages(
        *size,
        [
            pair
            for pair in Structure.without_walls(*size).passages()
            if pair in known or seen.isdisjoint(pair)
        ],
    )
    distances = hoped.distances(labyrinth.goal)
    moves = [action for action, cell in enumerate(hoped.moves[agent]) if cell != agent]
    return min(moves, key=lambda action: distances[hoped.moves[agent][action]])


@given(structure=connected_structures(), data=st.data(), memory=st.booleans())
def test_it_plans_with_what_it_has_seen_and_hopes_for_the_rest(structure, data, memory):
    cells = st.integers(0, structure.cells - 1)
    start, goal = data.draw(st.lists(cells, min_size=2, max_size=2, unique=True))
    labyrinth = Labyrinth(structure, start, goal, Task.PARTIAL_OBSERVABILITY)
    replanner = Replanner(structure.height, structure.width, memory=memory)
    replanner.reset(1)
    agent, seen, visited = start, set(), []
    while agent != goal and (memory or agent not in visited):
        visited.append(agent)
        seen = (seen if memory else set()) | structure.visible_from(agent)
        action = replanner.act(ObservationSpec("vector").look([(labyrinth, State(agent))]))[0]
        assert action == planned(labyrinth, agent, seen)
        assert structure.moves[agent][action] != agent
        agent = structure.moves[agent][action]
        assert len(visited) <= structure.cells**2


def test_with_memory_it_solves_every_labyrinth_and_each_in_the_batch_by_itself(datasets):
    arrays = load_arrays(datasets, CONFIG, "train", observation="vector")
    replanner = Replanner(3, 4)
    together = Player.of(replanner).step_through(arrays, 2)
    assert together.solved.all()
    assert (together.moves[0] == together.moves[1]).all()
    assert (together.moves >= arrays.distance).all()


@pytest.mark.slow
@pytest.mark.parametrize("task", Task)
def test_it_stands_beside_the_results_under_partial_observability_alone(datasets, task):
    config = CONFIGS[task]
    results = evaluate(lambda seen: [0] * len(seen), datasets, config, image_size=8, splits="test")
    content = results.to_json(Description("up"))
    hidden = task is Task.PARTIAL_OBSERVABILITY
    always = ["route_memory", "local_walls", "random", "oracle"]
    assert list(content["baselines"]) == always + ["replanner", "without memory"] * hidden
    assert ("replanner" in str(results)) == hidden
    if hidden:
        replanner = evaluate(Replanner(3, 4), datasets, config)
        own = replanner.splits["test"]
        assert content["baselines"]["replanner"]["test"] == own.summary()
        table = str(results).partition("\n\n")[2]
        assert re.search(rf"^test .* {100 * own.spl:.0f}/100  ", table, re.MULTILINE)


def test_it_is_made_anew_for_labyrinths_of_another_size_and_refuses_other_vectors(datasets):
    own, other = (
        evaluate(Replanner(*size), datasets, CONFIG, splits=["test"]).splits["test"]
        for size in ((3, 4), (4, 3))
    )
    assert own.episodes.moves.tolist() == other.episodes.moves.tolist()
    with pytest.raises(PolicyError, match="vectors without key and door, not of key_and_door"):
        evaluate(Replanner(3, 4), datasets, CONFIGS[Task.KEY_AND_DOOR])
