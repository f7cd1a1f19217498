"""The methods of `protocol=authors`: each departure from the usual methods, and from papers."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support.learning import equal_weights, states_seen_by, targets_of
from support.making import Run, perform

from labyrinth_core.evaluation import Results
from labyrinth_core.learning import Learner, Problem, outputs_of
from labyrinth_core.policies import RunRecord
from labyrinth_core.world import Labyrinth, Solver, Structure
from pipeline.config import ConfigError
from pipeline.training import train
from pipeline.training.identity import find
from pipeline.training.loop import PROTOCOLS, fit
from scripts.studies import try_authors
from scripts.studies.methods.authors import bco, iupe, sqil
from scripts.studies.methods.authors.learner import VISITS, AuthorsLearner, rows_of, try_out

pytestmark = pytest.mark.slow

Problems = Callable[..., Problem]

NAMES = ("bc", "dagger", "gail", "bco", "sqil", "iupe")
OF = {name: f"scripts.studies.methods.authors.{name}:Method" for name in NAMES}
"""The option `method` of each."""
ALL = pytest.mark.parametrize("name", NAMES)


def learner_of(name: str, problem: Problem, **values: Any) -> Any:
    small = {"batch_size": 64 if name in ("bco", "iupe") else 8, "learning_rate": 1e-3}
    small |= {"buffer": 200} if name == "sqil" else {}
    method, settings = find(OF[name], small | values, "authors")
    return method(problem, settings)


# All six.


@ALL
def test_the_settings_are_those_of_the_authors_script(name: str) -> None:
    _, settings = find(OF[name], {}, "authors")
    assert (settings.epochs, settings.evaluate_every, settings.batch_size) == (5000, 100, 1)
    assert settings.learning_rate == (1e-3 if name == "iupe" else 5e-4)


@ALL
def test_the_loss_falls(name: str, problem_of: Problems) -> None:
    learner = learner_of(name, problem_of())
    losses = [learner.epoch()["loss"] for _ in range(5)]
    if name == "gail":  # Of an adversary.
        assert all(np.isfinite(losses))
    else:
        assert losses[-1] < losses[0]


@ALL
def test_a_batch_of_one_row_and_the_cnn_will_do(name: str, problem_of: Problems) -> None:
    learner = learner_of(name, problem_of(encoder="cnn"), batch_size=1)
    learner.experience = problem_of().exploration().states[:3, None] * [1, 0, 1]
    before = {name: each.clone() for name, each in learner.policy.named_parameters()}
    assert np.isfinite(learner.epoch()["loss"])
    assert not equal_weights(before, learner.policy.state_dict())


@ALL
def test_the_same_seed_gives_the_same_weights_and_a_checkpoint_goes_on(
    name: str, problem_of: Problems, require_reproducible: Callable[..., None]
) -> None:
    require_reproducible(lambda seed: learner_of(name, problem_of(seed)))


def test_trying_a_policy_draws_nothing_that_training_draws(problem_of: Problems) -> None:
    problem = problem_of()
    learner = learner_of("sqil", problem)
    before = problem.rng.bit_generator.state, torch.get_rng_state().tolist()
    figures = learner.figures(uniform_policy, problem.arrays, problem.arrays)
    assert figures == learner.figures(uniform_policy, problem.arrays, problem.arrays)
    assert before == (problem.rng.bit_generator.state, torch.get_rng_state().tolist())


def uniform_policy(observations: Any) -> Any:
    return np.zeros((len(observations), 4), np.float32)


@pytest.mark.parametrize("name", ["bc", "dagger", "gail"])
def test_last_rows_of_episodes_are_learnt_from_and_the_learner_never_acts(
    name: str, problem_of: Problems, monkeypatch: pytest.MonkeyPatch
) -> None:
    learner = learner_of(name, problem_of())

    def forbidden(*_: Any) -> None:
        raise AssertionError("it looked at what its policy does")

    monkeypatch.setattr(Learner, "outputs", forbidden)
    monkeypatch.setattr(torch, "no_grad", forbidden)
    assert learner.problem.arrays.goal[states_seen_by(learner, epochs=1)].any()


# Rows and trials.


def test_a_last_row_repeats_the_action_before_it_and_counts_for_the_accuracy(
    problem_of: Problems,
) -> None:
    arrays, shown = problem_of().arrays, problem_of().demonstrations
    rows = rows_of(arrays)
    last = arrays.goal[rows.states]
    assert np.array_equal(rows.states[~last], shown.states)
    assert np.array_equal(rows.actions[~last], shown.actions)
    ends = np.flatnonzero(last)
    assert len(ends) == len(arrays.routes)
    assert np.array_equal(rows.next_states[ends], rows.states[ends])
    assert np.array_equal(rows.states[ends], rows.next_states[ends - 1])
    assert np.array_equal(rows.actions[ends], rows.actions[ends - 1])
    ups = AuthorsLearner.figures(uniform_policy, arrays, arrays)
    assert ups["validation_accuracy"] == pytest.approx((rows.actions == 0).mean())
    assert ups["validation_accuracy"] != pytest.approx((shown.actions == 0).mean())


@pytest.mark.parametrize(("visits", "steps"), [(5, 5), (None, 360)])
def test_an_episode_is_cut_where_a_picture_comes_again_too_often(
    problem_of: Problems, visits: int | None, steps: int
) -> None:
    arrays = problem_of().arrays
    downs = np.tile([0.0, 0, 1, 0], (len(arrays.terminal), 1))  # Into the outer wall, for ever.
    episodes, taken = try_out(arrays, downs, np.random.default_rng(0), visits)
    assert len(taken) == steps * len(arrays.initial)
    assert (episodes.returns == -4).all()


# DAgger.


def test_the_solvers_first_route_in_depth_joins_and_need_not_be_shortest(
    problem_of: Problems,
) -> None:
    learner = learner_of("dagger", problem_of(), episodes=3)
    arrays, before = learner.problem.arrays, len(learner.states)
    learner.epoch()
    states, labels = learner.states[before:], learner.labels[before:]
    begins = np.flatnonzero(np.isin(states, arrays.initial))
    assert len(begins) == 3
    routes = [Solver(each).simple_routes(limit=1)[0] for each in arrays.labyrinths]
    for part, routed in zip(
        np.split(states, begins[1:]), np.split(labels, begins[1:]), strict=True
    ):
        assert routed.tolist() == routes[arrays.labyrinth[part[0]]]
        assert arrays.goal[arrays.next_state[part[-1], routed[-1]]]
        assert np.array_equal(arrays.next_state[part[:-1], routed[:-1]], part[1:])
    without_walls = Labyrinth(Structure.without_walls(3, 3), 0, 2)
    assert len(Solver(without_walls).simple_routes(limit=1)[0]) > Solver(without_walls).moves


# GAIL.


def test_the_policy_is_changed_through_the_discriminator_which_sees_its_logits(
    problem_of: Problems, monkeypatch: pytest.MonkeyPatch
) -> None:
    learner = learner_of("gail", problem_of())
    learner.policy.eval()  # Without dropout, for the sums below.
    # This one calls an action vector an expert's by its first entry.
    monkeypatch.setattr(
        learner, "judge", lambda _, actions: actions[:, :1] + 0 * sum_of(learner.discriminator)
    )
    pictures = learner.see(learner.states[:8])
    shown = torch.eye(4)[[0, 0, 1, 1, 2, 2, 3, 3]]
    logits = learner.policy(pictures).detach()
    loss, policy_loss = learner.update(pictures, shown)
    softplus = torch.nn.functional.softplus
    own = softplus(logits[:, 0]).mean()
    assert loss == pytest.approx(float(softplus(-shown[:, 0]).mean() + own), rel=1e-5)
    assert policy_loss == pytest.approx(float(softplus(-logits[:, 0]).mean()), rel=1e-5)
    assert (learner.policy(pictures)[:, 0] > logits[:, 0]).all()


def sum_of(network: torch.nn.Module) -> torch.Tensor:
    return torch.stack([each.sum() for each in network.parameters()]).sum()


# BCO.


def test_the_model_sees_both_pictures_through_one_encoder(problem_of: Problems) -> None:
    learner = learner_of("bco", problem_of(encoder="cnn"))
    assert learner.model.encoder[0].in_channels == 3
    assert learner.model.classifier[0].in_features == 2 * learner.model.encoder.features
    pairs = learner.see(np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1]))
    assert len(outputs_of(learner.model, pairs).unique(dim=0)) == 4


def test_what_the_policy_does_on_train_joins_the_steps(problem_of: Problems) -> None:
    learner = learner_of("bco", problem_of(), evaluate_every=2)
    before, arrays = len(learner.experience), learner.problem.arrays
    assert learner.epoch()["experience"] == before
    learner.epoch()
    states, actions, after = learner.experience[before:].T
    assert np.array_equal(arrays.next_state[states, actions], after)
    greedy = learner.outputs(learner.policy).argmax(1).numpy()
    assert np.array_equal(actions, greedy[states])
    assert set(arrays.initial.tolist()) <= set(states.tolist())
    assert np.bincount(states).max() > VISITS  # Only the step limit ends an episode.


def test_labels_are_the_most_likely_actions(
    problem_of: Problems, monkeypatch: pytest.MonkeyPatch
) -> None:
    learner = learner_of("bco", problem_of())
    learned: list[Any] = []
    monkeypatch.setattr(Learner, "clone", lambda *given: learned.append(given[-1]) or 0.0)
    count = len(learner.problem.demonstrations.states)
    learner.learn(np.tile([0.1, 0.2, 0.4, 0.3], (count, 1)))
    assert learned[0].tolist() == [2] * count


# IUPE.


def test_labels_are_drawn_with_one_number_for_each_action() -> None:
    rng = np.random.default_rng(0)
    half = np.array([[0.5, 0, 0, 0.5]])
    drawn = np.concatenate([iupe.draw_labels(half, rng) for _ in range(20_000)])
    # Three of the sums are 1/2, so that the label counts how many of three coins fall.
    wanted = np.array([1, 3, 3, 1]) / 8
    assert np.abs(np.bincount(drawn, minlength=4) / 20_000 - wanted).max() < 0.015
    for _ in range(20):
        assert len(set(iupe.draw_labels(np.tile(half, (50, 1)), rng).tolist())) == 1
    assert iupe.draw_labels(np.eye(4), rng).tolist() == [0, 1, 2, 3]


def test_iupe_draws_its_actions_while_it_is_trained_and_not_afterwards() -> None:
    scores = torch.log(torch.tensor([[0.1, 0.2, 0.3, 0.4]]))
    assert np.allclose(iupe.Method.chances_in_training(scores), [[0.1, 0.2, 0.3, 0.4]])
    assert iupe.Method.chances(scores).tolist() == [[0, 0, 0, 1]]
    assert bco.Method.chances_in_training(scores).tolist() == [[0, 0, 0, 1]]


# SQIL.


def test_the_target_adds_gamma_and_keeps_the_value_where_the_episode_is_over(
    problem_of: Problems,
) -> None:
    problem = problem_of()
    arrays, learner = problem.arrays, learner_of("sqil", problem, gamma=0.75, batch_size=2)
    last = np.flatnonzero(arrays.done.any(axis=1) & ~arrays.terminal)[0]
    action = int(arrays.done[last].argmax())
    onto_goal = [last, action, arrays.next_state[last, action]]
    first = [int(arrays.initial[0]), 2, int(arrays.initial[0])]  # Into the outer wall.
    learner.own, learner.rows = np.array([first]), np.array([onto_goal])
    q = torch.tensor([0.0, 1.0, 2.0, 3.0])
    with torch.no_grad():
        learner.target.classifier[-1].weight.zero_()
        learner.target.classifier[-1].bias.copy_(q)
    value = 4 * np.log(np.exp(q.numpy() / 4).sum())
    wanted = [0 + 0.75 + value] * 2 + [1 + 0 + value] * 2
    assert targets_of(learner) == pytest.approx(wanted)


def test_the_target_network_is_copied_after_steps_1_2_and_4_alone(problem_of: Problems) -> None:
    learner = learner_of("sqil", problem_of())
    copied = []
    for step in range(12):
        learner.update()
        if equal_weights(dict(learner.policy.named_parameters()), learner.target.state_dict()):
            copied.append(step)
    assert copied == [1, 2, 4]


def test_sqil_draws_its_actions_also_when_it_is_tried(problem_of: Problems) -> None:
    scores = torch.tensor([[0.0, 0.0, 0.0, 4 * np.log(3)]])
    assert np.allclose(sqil.Method.chances(scores), [[1 / 6, 1 / 6, 1 / 6, 1 / 2]])
    arrays = problem_of().arrays
    tried = sqil.Method.as_tried(uniform_policy, arrays)
    assert 0 < tried["sr"] < 1
    greedy = AuthorsLearner.as_tried(uniform_policy, arrays)
    assert greedy["sr"] != tried["sr"]


def test_the_buffer_begins_full_and_forgets_the_oldest_step(problem_of: Problems) -> None:
    learner = learner_of("sqil", problem_of(), buffer=100)
    assert learner.own.shape == (100, 3)
    assert np.array_equal(learner.rows, np.stack(rows_of(learner.problem.arrays), axis=1))
    arrays, before = learner.problem.arrays, learner.own.copy()
    for _ in range(3):
        learner.act()
    assert np.array_equal(learner.own[3:], before[3:])
    states, actions, after = learner.own[:3].T
    assert np.array_equal(arrays.next_state[states, actions], after)
    assert states[0] in arrays.initial


# What is kept.


@pytest.mark.parametrize(
    ("name", "figure", "kept"),
    [
        ("bc", "validation_accuracy", 2),
        ("dagger", "validation_accuracy", 2),
        ("gail", "validation_accuracy", 2),
        ("sqil", "validation_accuracy", 2),
        ("iupe", "train_return", 2),
        ("bco", "nothing", 4),
    ],
)
def test_each_method_keeps_the_first_best_policy_by_its_own_figure(
    problem_of: Problems, tmp_path: Path, name: str, figure: str, kept: int
) -> None:
    learner = learner_of(name, problem_of(), epochs=4, evaluate_every=1)
    learner.__class__ = type("Idle", (type(learner),), {"epoch": lambda _: {"loss": 1.0}})
    tried = iter([-4.0, 0.9, 0.9, 0.2])
    misleading = {"validation_accuracy": 0.1, "train_return": 0.1}

    def judge(_: Any) -> dict[str, float]:
        return {"validation_sr": 0.5, **misleading, figure: next(tried)}

    path = tmp_path / "checkpoint"
    done = fit(learner, judge, PROTOCOLS["authors"], path, {}, lambda _: None)
    assert done.best is not None
    assert done.best["epoch"] == kept


# The stages.


def test_a_run_of_the_protocol_says_what_is_changed_and_is_evaluated_as_the_code_tries_it(
    small_dataset: Run,
    make_run: Callable[..., Run],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = make_run(
        small_dataset.data_dir,
        stages=["train"],
        run_dir=str(tmp_path),
        protocol="authors",
        method={"name": OF["sqil"], "epochs": 1, "batch_size": 8, "buffer": 100},
    )
    train.run(run)
    told = " ".join(capsys.readouterr().out.split())
    assert "but method.epochs=1 instead of 5,000, method.batch_size=8 instead of 1" in told
    record = json.loads((run.training_folder / RunRecord.FILE).read_text())
    assert run.training_folder.name == "sqil-cnn-seed0-authors"
    assert {"validation_accuracy", "train_return"} <= record["selected"].keys()
    perform("evaluate", run)
    results = Results.load(run.training_folder / "results.json").run
    assert results is not None
    assert results.as_tried is None
    data = str(small_dataset.data_dir / "3x3")
    monkeypatch.setattr("sys.argv", ["try_authors.py", str(run.training_folder), data])
    try_authors.main()
    assert "As in the code of the authors: train" in capsys.readouterr().out
    found = Results.load(run.training_folder / "results.json")
    assert found.run is not None
    assert found.run.as_tried is not None
    assert found.run.as_tried.keys() == found.splits.keys()
    assert 0 < found.run.as_tried["test"]["sr"] <= 1
    perform("evaluate", run)  # The file is still the run's own.


def test_the_usual_settings_are_refused_in_one_line() -> None:
    with pytest.raises(ConfigError) as caught:
        find(OF["bc"], {"augment": False}, "authors")
    assert "method.augment is not an option: choose from [method.epochs" in str(caught.value)


def test_methods_of_the_authors_and_others_are_not_mixed_up() -> None:
    for name, protocol, told in (
        ("planner", "authors", "method=planner supports only default or paper"),
        (OF["bc"], "default", r"method=\S*bc:Method supports only authors"),
    ):
        with pytest.raises(ConfigError, match=rf"\Aprotocol={protocol}: {told}\Z"):
            find(name, {}, protocol)
