"""Relabelled examples show optimal actions in valid labyrinths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.learning import learner_of
from support.making import DemonstrationsConfig, Run

from labyrinth_core import load_arrays
from labyrinth_core.data import Dataset
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import PolicyError
from labyrinth_core.learning import NetworkSpec, Problem
from labyrinth_core.world import Episode, Task

pytestmark = pytest.mark.slow


NO_LABEL = -1


def problem_in(folder: Path, config: str, task: str) -> Problem:
    """Return the problem of a dataset."""
    arrays = load_arrays(folder, config, "train")
    spec = NetworkSpec("cnn", 3, 4, task)
    return Problem.of_dataset(Dataset(folder, config), arrays, spec, learner="a test")


def sampler_of(datasets: Path, task: str) -> Any:
    config = "3x4" if task == "navigation" else f"3x4-{task}"
    return problem_in(datasets, config, task).examples


@pytest.mark.parametrize("task", list(map(str, Task)))
def test_each_part_of_a_route_leads_to_its_goal(datasets: Path, task: str) -> None:
    sampler = sampler_of(datasets, task)
    reversed_parts = 0
    for number in range(len(sampler)):
        episode, parts = sampler.episode(number), sampler.parts(number)
        assert (0, len(episode)) in parts
        for first, last in parts:
            step = 1 if first < last else -1
            reversed_parts += step < 0
            ends = (episode.states[first].agent, episode.states[last].agent)
            labyrinth = replace(episode.labyrinth, start=ends[0], goal=ends[1])
            for place in range(first, last, step):
                action = (
                    episode.actions[place] if step > 0 else (episode.actions[place - 1] + 2) % 4
                )
                state = episode.states[place]
                assert not labyrinth.is_terminal(state)
                assert labyrinth.transition(state, action) == episode.states[place + step]
    assert (reversed_parts > 0) == (task != "key_and_door")


def is_episode(episode: Episode, first: int, last: int) -> bool:
    """Return whether a part is a complete episode of the labyrinth with the part's ends."""
    ends = [episode.states[place].agent for place in (first, last)]
    try:
        labyrinth = replace(episode.labyrinth, start=ends[0], goal=ends[1])
        part = labyrinth.replay(episode.actions[first:last].tolist())
    except ValueError:
        return False
    return part.states == episode.states[first : last + 1]


@pytest.mark.parametrize("task", ["navigation", "key_and_door"])
def test_all_parts_of_a_route_are_found_and_counted_without_being_held(
    datasets: Path, task: str
) -> None:
    sampler = sampler_of(datasets, task)
    for number in range(len(sampler)):
        episode, parts = sampler.episode(number), sampler.parts(number)
        pairs = permutations(range(len(episode) + 1), 2)
        if task == "key_and_door":
            pairs = (pair for pair in pairs if pair[0] < pair[1] and is_episode(episode, *pair))
        assert [*parts] == [*pairs]
        held = [each for each in vars(parts).values() if isinstance(each, np.ndarray)]
        assert max(map(len, held)) <= len(episode) + 2


def test_only_the_episodes_that_are_drawn_are_replayed(datasets: Path) -> None:
    sampler = sampler_of(datasets, "navigation")
    sampler.draw(2, np.random.default_rng(0), relabel=True, whole=False)
    replayed = [each.cache_info().currsize for each in (sampler.episode, sampler.parts)]
    assert replayed == [2, 2]
    assert len(sampler) > 2


@pytest.mark.parametrize("name", ["augment", "average"])
def test_vectors_are_not_transformed_as_pictures(
    problem_of: Callable[..., Problem], name: str
) -> None:
    with pytest.raises(PolicyError, match=f"method.{name} transforms pictures: leave it out with"):
        learner_of("bc", problem_of(encoder="mlp"), **{name: True})


@pytest.mark.parametrize("name", ["bc", "planner"])
def test_routes_that_are_not_shortest_are_not_relabelled(
    problem_of: Callable[..., Problem], name: str
) -> None:
    problem = problem_of(encoder="cnn")
    learner_of(name, problem, relabel=True)
    arrays = problem.arrays
    start = arrays.initial[:1]
    longer = np.flatnonzero(~arrays.optimal[start[0]])[:1]
    arrays = replace(
        arrays,
        routes=(*arrays.routes, longer, longer),
        route_starts=np.concatenate([arrays.route_starts, start, start]),
    )
    problem = problem_of(encoder="cnn", arrays=arrays)
    count = sum(map(len, arrays.routes))
    words = rf"\Amethod\.relabel=true: .* 2 of {count} demonstrated .*\.relabel=false\Z"
    with pytest.raises(DatasetError, match=words):
        learner_of(name, problem, relabel=True)
    learner_of(name, problem, relabel=False)


def test_whole_routes_are_labelled_where_they_go(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(encoder="cnn")
    _, labels = problem.examples.draw(40, np.random.default_rng(0), relabel=False, whole=True)
    _, actions = problem.examples.draw(40, np.random.default_rng(0), relabel=False, whole=False)
    told = {tuple(each.ravel().tolist()) for each in labels}
    arrays = problem.arrays
    expected = set()
    for first, route in zip(arrays.initial.tolist(), arrays.routes, strict=True):
        cells, state = np.full((3, 3), NO_LABEL), first
        for action in route.tolist():
            cells[2 - arrays.position[state] // 3, arrays.position[state] % 3] = action
            state = arrays.next_state[state, action]
        expected.add(tuple(cells.ravel().tolist()))
    assert told <= expected
    assert all(action in each for action, each in zip(actions.tolist(), labels, strict=True))


@pytest.mark.parametrize("task", ["navigation", "key_and_door", "icy_floor"])
def test_examples_of_routes_that_err_are_learnt_from_as_they_are_where_none_is_relabelled(
    build: Callable[..., Run], tmp_path: Path, task: str
) -> None:
    shown = DemonstrationsConfig(noise=0.7)
    run = build(tmp_path, size="4", task=task, labyrinths=4, demonstrations=shown)
    problem = problem_in(tmp_path, run.dataset.name, task)
    arrays, sampler, steps = problem.arrays, problem.examples, problem.demonstrations
    episodes = [sampler.episode(number) for number in range(len(sampler))]
    assert len(steps.states) == sum(map(len, episodes))
    lasts = np.cumsum([len(episode) for episode in episodes]) - 1
    ended = [episode.terminated for episode in episodes]
    assert arrays.done[steps.states, steps.actions][lasts].tolist() == ended
    on_ice = [each.states[-1].agent in each.labyrinth.ice for each in episodes]
    assert any(on_ice) == (task == "icy_floor")
    for number in range(len(sampler)):
        episode, parts = sampler.episode(number), sampler.parts(number)
        for first, last in parts:
            ends = {episode.states[first].agent, episode.states[last].agent}
            assert len(ends) == 2
            assert ends.isdisjoint(episode.labyrinth.ice)
    rng = np.random.default_rng(0)
    shown = zip(arrays.observations[steps.states], steps.actions.tolist(), strict=True)
    drawn = zip(*sampler.draw(40, rng, relabel=False, whole=False), strict=True)
    published = {(picture.tobytes(), action) for picture, action in shown}
    assert {(picture.tobytes(), int(action)) for picture, action in drawn} <= published
    sampler.draw(40, rng, relabel=True, whole=True)


def test_under_partial_observability_the_agents_cell_alone_is_labelled(datasets: Path) -> None:
    sampler, rng = sampler_of(datasets, "partial_observability"), np.random.default_rng(0)
    for _ in range(40):
        (labyrinth, state), labels = sampler.example(rng, relabel=True, whole=True)
        (cell,) = np.flatnonzero(labels[::-1] != NO_LABEL)
        assert cell == state.agent
        assert labyrinth.transition(state, labels[::-1].flat[cell]) != state
