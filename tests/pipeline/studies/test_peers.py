"""The peers of the planner: a value iteration network, and a classifier of walls with a search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from learning import settings_of

from labyrinth_core.data.observations import ObservationSpec
from labyrinth_core.evaluation.answers import Player
from labyrinth_core.evaluation.labyrinth_arrays import as_arrays, load_arrays
from labyrinth_core.evaluation.playing import attempts, solved_by, success_rate
from labyrinth_core.pictures.renderer import render
from labyrinth_core.policies.networks.acting import NetworkPolicy
from labyrinth_core.policies.networks.network import as_input
from labyrinth_core.policies.spec import NetworkSpec
from labyrinth_core.world.dynamics import State, initial
from labyrinth_core.world.labyrinth import Labyrinth, Look
from labyrinth_core.world.sampling import sample_structures
from pipeline.config.errors import ConfigError
from pipeline.config.run import Run
from pipeline.training.methods.method import Learner, Problem, find
from scripts.studies.methods import vin, walls

pytestmark = pytest.mark.slow

Problems = Callable[..., Problem]

TOYS: dict[str, dict[str, Any]] = {
    "vin": {"epochs": 60, "batch_size": 8, "learning_rate": 5e-3, "iterations": 12},
    "walls": {"epochs": 3, "pictures": 512},
}
OF = {name: f"scripts.studies.methods.{name}:Method" for name in TOYS}
"""The option `method` of each."""
BOTH = pytest.mark.parametrize("name", list(TOYS))


def learner_of(name: str, problem: Problem, **values: Any) -> Learner:
    method, settings = find(OF[name], TOYS[name] | values)
    return method(problem, settings)


def fresh(side: int, count: int) -> list[Labyrinth]:
    drawn = sample_structures(side, side, np.random.default_rng(7))
    return [Labyrinth(next(drawn), 0, side * side - 1) for _ in range(count)]


def test_a_value_iteration_network_learns_train(problem_of: Problems) -> None:
    learner = learner_of("vin", problem_of(encoder="cnn"))
    losses = [learner.epoch()["loss"] for _ in range(learner.settings.epochs)]
    assert losses[-1] < losses[0]
    assert success_rate(NetworkPolicy(learner.policy), learner.problem.arrays) >= 0.75


@BOTH
def test_they_see_squares_of_any_size_and_refuse_rectangles(name: str) -> None:
    method, settings = find(OF[name], {})
    spec = NetworkSpec(name, 1, 5, 5, "navigation")
    assert method.image_size(spec, settings, 10, 10) == 128
    policy = method.make(spec, settings).eval()
    pictures = np.stack([render(each, initial(each), 128) for each in fresh(10, 2)])
    assert policy(torch.from_numpy(pictures)).shape == (2, 4)
    told = rf"\Asize=4x6: method={name} needs as many rows as columns\Z"
    with pytest.raises(ConfigError, match=told):
        method.image_size(spec, settings, 4, 6)
    with pytest.raises(ConfigError, match=told):
        method.make(replace(spec, height=4, width=6), settings)


@BOTH
def test_where_no_colour_is_known_the_scores_are_numbers(name: str) -> None:
    method, settings = find(OF[name], {})
    labyrinth = replace(fresh(5, 1)[0], look=Look.RECOLOURED)
    picture = torch.from_numpy(render(labyrinth, State(7), 64))[None]
    policy = method.make(NetworkSpec(name, 1, 5, 5, "navigation"), settings).eval()
    assert policy(picture).isfinite().all()


def test_a_value_iteration_network_has_the_published_recursion() -> None:
    torch.manual_seed(0)
    settings = settings_of(OF["vin"], iterations=3, reward_channels=4, action_channels=2)
    network = vin.ValueIteration(2, settings).eval()
    picture = torch.from_numpy(render(fresh(2, 1)[0], State(2), 64))[None]
    with torch.no_grad():
        seen = network.see(vin.on_grid(as_input(picture), 32)).relu()
        reward = network.reward(network.hidden(seen))[0, 0].numpy()
        kernels = [
            each.weight[:, 0].numpy() for each in (network.after_reward, network.after_value)
        ]
        scores = network(picture)[0].numpy()
    assert reward.shape == (5, 5)
    value = np.zeros((5, 5))
    for _ in range(3):
        q = np.zeros((2, 5, 5))
        for kernel, near in zip(kernels, (np.pad(reward, 1), np.pad(value, 1)), strict=True):
            for row, column in np.ndindex(3, 3):
                part = near[row : row + 5, column : column + 5]
                q += kernel[:, row, column, None, None] * part
        value = q.max(0)
    # The agent is in cell 2, at the left of the upper row.
    expected = network.choose.weight.detach().numpy() @ q[:, 1, 1]
    assert np.allclose(scores, expected, atol=1e-6)


def test_a_network_of_another_size_iterates_in_proportion() -> None:
    network = vin.ValueIteration(5, settings_of(OF["vin"], iterations=10)).eval()
    calls = []
    network.after_value.register_forward_hook(lambda *_: calls.append(1))
    for side in (5, 10):
        calls.clear()
        network(torch.zeros(1, round(64 * side / 5), round(64 * side / 5), 3, dtype=torch.uint8))
        assert len(calls) == 2 * side - 1


def test_what_is_known_of_walls_is_what_the_steps_have_shown(problem_of: Problems) -> None:
    problem = problem_of(encoder="cnn")
    learner = walls.Method(problem, settings_of(OF["walls"]))
    shown = 0
    for number, labyrinth in enumerate(problem.arrays.labyrinths):
        moves = labyrinth.structure.moves
        for cell in range(9):
            for action in range(4):
                label = learner.known[number, action, 2 - cell // 3, cell % 3]
                assert label in (walls.UNKNOWN, moves[cell][action] == cell)
                shown += label != walls.UNKNOWN
    assert shown > 0.7 * learner.known.size


def test_the_search_takes_a_shortest_way_where_the_walls_are_seen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    labyrinths = fresh(5, 10)
    network = walls.Walls(5, 4).eval()
    for labyrinth in labyrinths:
        stays = np.array(labyrinth.structure.moves) == np.arange(25)[:, None]
        seen = torch.from_numpy(stays.T.reshape(4, 5, 5)[:, ::-1].copy()).float()[None] - 0.5
        monkeypatch.setattr(
            network, "walls", lambda image, seen=seen: seen.expand(len(image), -1, -1, -1)
        )
        arrays = as_arrays([labyrinth], ObservationSpec("image", 64, draw=True))
        (episode,) = attempts(Player.of(NetworkPolicy(network), 0), arrays, [0])
        assert episode.states[-1].agent == labyrinth.goal
        assert len(episode) == labyrinth.structure.least_moves(0, 24)


def test_a_classifier_of_walls_solves_labyrinths_never_seen_and_larger_ones(
    problem_of: Problems, small_dataset: Run
) -> None:
    learner = learner_of("walls", problem_of(encoder="cnn"), epochs=6)
    for _ in range(learner.settings.epochs):
        accuracy = learner.epoch()["accuracy"]
    assert accuracy > 0.97
    policy = NetworkPolicy(learner.policy)
    assert success_rate(policy, load_arrays(small_dataset.data_dir, "3x3", "test")) >= 0.75
    size = walls.Method.image_size(learner.problem.spec, learner.settings, 6, 6)
    larger = as_arrays(fresh(6, 10), ObservationSpec("image", size, draw=True))
    assert solved_by(policy, larger).mean() >= 0.7


def test_walls_are_all_that_stops_the_agent_of_the_search() -> None:
    spec = NetworkSpec("walls", 1, 5, 5, "key_and_door")
    with pytest.raises(ConfigError, match=r"\Atask=key_and_door: method=walls searches for the"):
        walls.Method.make(spec, settings_of(OF["walls"]))
