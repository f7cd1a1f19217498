"""Labyrinths as arrays: what they say is what dynamics, solver and dataset say."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from support.labyrinths_of_datasets import CONFIGS, labyrinths_of

from labyrinth_core import load_arrays, load_episodes
from labyrinth_core.data import SPLITS
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import LabyrinthArrays, labyrinth_arrays
from labyrinth_core.pictures import PICTURE_SIZE, Looks, ObservationSpec, observations
from labyrinth_core.world import Look, Solver


@pytest.mark.parametrize("config", CONFIGS.values())
@pytest.mark.parametrize("split", ["train", "random", "s0_and_g"])
def test_walking_in_the_arrays_is_walking_in_the_labyrinths(datasets, config, split):
    arrays = load_arrays(datasets, config, split, image_size=8)
    labyrinths = labyrinths_of(datasets, config, split)
    assert arrays.labyrinth_ids.tolist() == list(labyrinths)
    seen = 0
    for place, labyrinth in enumerate(labyrinths.values()):
        numbers = {labyrinth.initial: arrays.initial[place]}
        queue = list(numbers)
        for state in queue:
            number = numbers[state]
            assert arrays.labyrinth[number] == place
            assert arrays.position[number] == state.agent
            assert arrays.goal[number] == (state.agent == labyrinth.goal)
            assert arrays.terminal[number] == labyrinth.is_terminal(state)
            if arrays.terminal[number]:
                assert (arrays.next_state[number] == number).all()
                assert (arrays.rewards[number] == 0).all()
                assert arrays.done[number].all()
                assert not arrays.optimal[number].any()
                continue
            for action in range(4):
                after = labyrinth.transition(state, action)
                queue += [after] * (after not in numbers)
                assert (
                    numbers.setdefault(after, arrays.next_state[number, action])
                    == (arrays.next_state[number, action])
                )
                assert arrays.rewards[number, action] == np.float32(labyrinth.reward(after))
                assert arrays.done[number, action] == labyrinth.is_terminal(after)
        assert len(set(numbers.values())) == len(numbers)
        seen += len(numbers)
    assert seen == len(arrays.labyrinth) == len(arrays.observations)


@pytest.mark.parametrize("config", CONFIGS.values())
def test_optimal_actions_are_those_of_all_shortest_routes(datasets, config):
    arrays = load_arrays(datasets, config, "test", image_size=8)
    for place, labyrinth in enumerate(labyrinths_of(datasets, config, "test").values()):
        routes = Solver(labyrinth).shortest_routes()
        assert arrays.distance[place] == len(routes[0])
        state = arrays.initial[place]
        assert set(np.flatnonzero(arrays.optimal[state])) == {route[0] for route in routes}
        for route in routes:
            state = arrays.initial[place]
            for action in route:
                assert arrays.optimal[state, action]
                state = arrays.next_state[state, action]
            assert arrays.goal[state]


@pytest.mark.slow
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
    arrays = load_arrays(datasets, config, "random", **arguments)
    place = {number: place for place, number in enumerate(arrays.labyrinth_ids.tolist())}
    for episode in load_episodes(datasets, config, split="random", **arguments):
        state = arrays.initial[place[episode.labyrinth_id]]
        for step, action in enumerate([*episode.actions, 0]):
            np.testing.assert_array_equal(arrays.observations[state], episode.observations[step])
            state = arrays.next_state[state, action]


@pytest.mark.parametrize("config", CONFIGS.values())
@pytest.mark.parametrize(("size", "kept"), [(32, 2**28), (32, 0), (PICTURE_SIZE, 2**28)])
def test_pictures_that_are_too_many_to_hold_are_drawn_when_they_are_looked_at(
    datasets, config, size, kept, monkeypatch
):
    monkeypatch.setattr(observations, "KEPT_BYTES", kept)
    load = partial(load_arrays, datasets, config, "test", image_size=size)
    held = load().observations
    monkeypatch.setattr(observations, "HELD_BYTES", held.nbytes)
    assert isinstance(load().observations, np.ndarray)
    monkeypatch.setattr(observations, "HELD_BYTES", held.nbytes - 1)
    drawn = load().observations
    assert isinstance(drawn, Looks)
    assert len(drawn) == len(held)
    states = np.arange(len(held))[::-2]
    np.testing.assert_array_equal(drawn[states], held[states])
    assert drawn[states[:0]].shape == held[:0].shape


@pytest.mark.parametrize("config", CONFIGS.values())
@pytest.mark.parametrize("observation", ["vector", "text"])
def test_vectors_and_texts_that_are_too_many_to_hold_are_made_when_they_are_looked_at(
    datasets, config, observation, monkeypatch
):
    load = partial(load_arrays, datasets, config, "test", observation=observation)
    held = load().observations
    monkeypatch.setattr(observations, "HELD_BYTES", held.nbytes - 1)
    made = load().observations
    assert isinstance(made, Looks)
    states = np.arange(len(held))[::-2]
    np.testing.assert_array_equal(made[states], held[states])


@pytest.mark.parametrize("observation", observations.OBSERVATIONS)
def test_labyrinths_of_several_looks_are_each_drawn_in_their_own(datasets, observation):
    labyrinths = list(labyrinths_of(datasets, "3x4", "test").values())
    labyrinths = [*labyrinths, *(replace(each, look=Look.RECOLOURED) for each in labyrinths)]
    arrays = LabyrinthArrays.of_labyrinths(
        labyrinths[::2] + labyrinths[1::2], ObservationSpec(observation, 32, True)
    )
    seen = arrays.observations[np.arange(len(arrays.state))[::-1]][::-1]
    for place, labyrinth in enumerate(arrays.labyrinths):
        for index in np.flatnonzero(arrays.labyrinth == place).tolist():
            view = labyrinth, labyrinth.state_at(int(arrays.state[index]))
            np.testing.assert_array_equal(seen[index], arrays.spec.look([view])[0])


def test_a_place_is_the_number_of_a_state(datasets):
    arrays = load_arrays(datasets, "3x4-key_and_door", "test", observation="vector")
    places = list(arrays.places)[::-1]
    assert arrays.numbers_of(places).tolist() == list(range(len(places)))[::-1]
    number, _ = places[0]
    for wrong in [(number, 999), (number + 1, 0)]:
        with pytest.raises(DatasetError, match=r"begins where the agent cannot get"):
            arrays.numbers_of([places[1], wrong])


@pytest.mark.parametrize("split", SPLITS.base)
def test_demonstrations_are_counted_step_by_step(datasets, split):
    arrays = load_arrays(datasets, "3x4", split, image_size=8)
    episodes = list(load_episodes(datasets, "3x4", split=split, draw=True))
    assert [route.tolist() for route in arrays.routes] == [
        episode.actions.tolist() for episode in episodes
    ]
    assert arrays.demonstrated.sum() == sum(map(len, episodes))
    assert not arrays.on_demonstration[arrays.terminal].any()
    assert arrays.on_demonstration[arrays.initial].all()
    if split == "train":  # All simple routes: every optimal action of the first state is there.
        first = arrays.initial
        assert (arrays.demonstrated[first] > 0)[arrays.optimal[first]].all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"config": "9x9"}, "config=9x9: .* holds 3x4, "),
        ({"resize": "nearest"}, "resize=nearest: choose one of area, original"),
        ({"image_size": 601}, "image_size=601: give a whole number from 1 to 600"),
    ],
)
def test_what_cannot_be_loaded_is_said_in_one_line(datasets, arguments, message):
    values = {"source": datasets, "config": "3x4", "split": "train"} | arguments
    with pytest.raises((ValueError, DatasetError), match=message) as error:
        load_arrays(**values)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("some", "count"), [({}, 5), ({"labyrinths": 2}, 2)])
def test_too_little_memory_for_the_states_is_said_with_how_much_they_take(
    datasets, some, count, monkeypatch
):
    def exhausted(*_):
        raise MemoryError

    monkeypatch.setattr(labyrinth_arrays.Tables, "of", exhausted)
    monkeypatch.setattr(labyrinth_arrays, "STATE_BYTES", 10**9)
    needed = f"{12 * count:.1f} GB, and what is seen in them up to 1 GB, more than there is"
    told = f"split=test: the states of {count} labyrinths take about {needed}"
    with pytest.raises(DatasetError, match=told):
        load_arrays(datasets, "3x4", "test", **some)


@pytest.mark.parametrize("config", CONFIGS.values())
def test_labyrinths_of_no_dataset_are_the_same_arrays_but_for_demonstrations(datasets, config):
    arrays = load_arrays(datasets, config, "test", image_size=8)
    again = LabyrinthArrays.of_labyrinths(arrays.labyrinths, arrays.spec)
    for name in ("initial", "next_state", "rewards", "optimal", "distance", "labyrinth_ids"):
        assert np.array_equal(getattr(again, name), getattr(arrays, name)), name
    states = np.arange(len(arrays.terminal))
    assert np.array_equal(again.observations[states], arrays.observations)
    assert not again.demonstrated.any()
