"""Labyrinths as arrays: what they say is what dynamics, solver and dataset say."""

from __future__ import annotations

import numpy as np
import pytest
from labyrinths_of_datasets import CONFIGS, labyrinths_of

from labyrinth_core.data.columns import SPLITS
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.loader import load_episodes
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays, load_arrays
from labyrinth_core.world.dynamics import initial, is_terminal, reward, transition
from labyrinth_core.world.solver import shortest_routes


@pytest.mark.parametrize("config", CONFIGS.values())
@pytest.mark.parametrize("split", ["train", "random", "s0_and_g"])
def test_walking_in_the_arrays_is_walking_in_the_labyrinths(datasets, config, split):
    worlds = load_arrays(datasets, config, split, image_size=8)
    labyrinths = labyrinths_of(datasets, config, split)
    assert worlds.labyrinth_ids.tolist() == list(labyrinths)
    seen = 0
    for place, labyrinth in enumerate(labyrinths.values()):
        numbers = {initial(labyrinth): worlds.initial[place]}
        queue = list(numbers)
        for state in queue:
            number = numbers[state]
            assert worlds.labyrinth[number] == place
            assert worlds.position[number] == state.agent
            assert worlds.goal[number] == (state.agent == labyrinth.goal)
            assert worlds.terminal[number] == is_terminal(labyrinth, state)
            if worlds.terminal[number]:
                assert (worlds.next_state[number] == number).all()
                assert (worlds.rewards[number] == 0).all()
                assert worlds.done[number].all()
                assert not worlds.optimal[number].any()
                continue
            for action in range(4):
                after = transition(labyrinth, state, action)
                queue += [after] * (after not in numbers)
                assert (
                    numbers.setdefault(after, worlds.next_state[number, action])
                    == (worlds.next_state[number, action])
                )
                assert worlds.rewards[number, action] == np.float32(reward(labyrinth, after))
                assert worlds.done[number, action] == is_terminal(labyrinth, after)
        assert len(set(numbers.values())) == len(numbers)
        seen += len(numbers)
    assert seen == len(worlds.labyrinth) == len(worlds.observations)


@pytest.mark.parametrize("config", CONFIGS.values())
def test_optimal_actions_are_those_of_all_shortest_routes(datasets, config):
    worlds = load_arrays(datasets, config, "test", image_size=8)
    for place, labyrinth in enumerate(labyrinths_of(datasets, config, "test").values()):
        routes = shortest_routes(labyrinth)
        assert worlds.distance[place] == len(routes[0])
        state = worlds.initial[place]
        assert set(np.flatnonzero(worlds.optimal[state])) == {route[0] for route in routes}
        for route in routes:
            state = worlds.initial[place]
            for action in route:
                assert worlds.optimal[state, action]
                state = worlds.next_state[state, action]
            assert worlds.goal[state]


@pytest.mark.parametrize("config", CONFIGS.values())
@pytest.mark.parametrize(
    "arguments",
    [
        {"image_size": 64},
        {"image_size": 64, "resize": "original"},
        {"image_size": 600},
        {"observation": "vector"},
    ],
    ids=str,
)
def test_what_is_seen_is_what_the_dataset_shows(datasets, config, arguments):
    worlds = load_arrays(datasets, config, "random", **arguments)
    place = {number: place for place, number in enumerate(worlds.labyrinth_ids.tolist())}
    for episode in load_episodes(datasets, config, split="random", **arguments):
        state = worlds.initial[place[episode.labyrinth_id]]
        for step, action in enumerate([*episode.actions, 0]):
            np.testing.assert_array_equal(worlds.observations[state], episode.observations[step])
            state = worlds.next_state[state, action]


@pytest.mark.parametrize("split", SPLITS)
def test_demonstrations_are_counted_step_by_step(datasets, split):
    worlds = load_arrays(datasets, "3x4", split, image_size=8)
    episodes = list(load_episodes(datasets, "3x4", split=split, draw=True))
    assert [route.tolist() for route in worlds.routes] == [
        episode.actions.tolist() for episode in episodes
    ]
    assert worlds.demonstrated.sum() == sum(map(len, episodes))
    assert not worlds.on_demonstration[worlds.terminal].any()
    assert worlds.on_demonstration[worlds.initial].all()
    if split == "train":  # All simple routes: every optimal action of the first state is there.
        first = worlds.initial
        assert (worlds.demonstrated[first] > 0)[worlds.optimal[first]].all()


def test_a_step_limit_is_forty_times_the_cells(datasets):
    worlds: LabyrinthArrays = load_arrays(datasets, "3x4", "train", image_size=8)
    assert (worlds.cells, worlds.step_limit) == (12, 480)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"config": "9x9"}, "config=9x9: .* holds 3x4, "),
        ({"split": "eval"}, "split=eval: the dataset has train, "),
        ({"source": "nowhere at all"}, "neither a folder nor an id"),
        ({"resize": "nearest"}, "resize=nearest: choose one of area, original"),
        ({"resize": "original", "image_size": 601}, "image_size=601: resize=original goes up to"),
        ({"observation": "smell"}, "observation=smell: choose one of"),
    ],
)
def test_what_cannot_be_loaded_is_said_in_one_line(datasets, arguments, message):
    values = {"source": datasets, "config": "3x4", "split": "train"} | arguments
    with pytest.raises((ValueError, DatasetError), match=message) as error:
        load_arrays(**values)
    assert "\n" not in str(error.value)
