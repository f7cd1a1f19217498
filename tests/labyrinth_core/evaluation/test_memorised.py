"""`memorised`: against an oracle, against policies that copy at random, and what it refuses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from support.making import Run, SplitsConfig
from support.policies import Chance, Remembering, Rounds, Table, chance
from support.remembering import local_walls

from labyrinth_core import Dataset, PolicyError, load_arrays, load_episodes, memorised, parse
from labyrinth_core.data import DatasetConfig
from labyrinth_core.evaluation import LabyrinthArrays
from labyrinth_core.evaluation import memorised as module
from labyrinth_core.evaluation.twins import (
    Demonstrated,
    Twins,
    control_sets,
    mean_of,
    train_set,
    without_effects,
)
from labyrinth_core.world import Labyrinth

Build = Callable[..., Run]

CONTROLS = 10


# The oracle: plain loops over labyrinths as sets of passages, for navigation.


def demonstrations(folder: Path) -> list[tuple[frozenset[Any], int, Counter[int]]]:
    """Return the passages, the cell and the actions of each state that train demonstrates."""
    found: dict[tuple[frozenset[Any], int], Counter[int]] = {}
    for episode in load_episodes(folder, "4x4", split="train", observation="vector"):
        passages = frozenset(parse(episode.info).structure.passages())
        grid = [cell * 2 % 8 + cell // 4 * 14 for cell in range(16)]
        cells = [grid.index(int(vector[0])) for vector in episode.observations]
        for cell, action in zip(cells, episode.actions.tolist(), strict=False):
            found.setdefault((passages, cell), Counter())[action] += 1
    return [(*key, actions) for key, actions in found.items()]


def voted(train: Any, passages: frozenset[Any], cell: int, softness: float) -> list[float] | None:
    """Return the shares of the actions in the nearest demonstrated states, or in all, weighted."""
    there = [(len(passages ^ other), actions) for other, at, actions in train if at == cell]
    if not there:
        return None
    least = min(apart for apart, _ in there)
    votes = [0.0] * 4
    for apart, actions in there:
        weight = np.exp((least - apart) / softness) if softness else float(apart == least)
        for action, count in actions.items():
            votes[action] += weight * count / actions.total()
    return [round(vote, 3) if softness else vote / sum(votes) for vote in votes]


def oracle(
    states: list[tuple[Labyrinth, int]], trains: list[Any], acts: list[int], best: list[list[float]]
) -> tuple[list[list[Any]], NDArray[np.float64]]:
    """Return what each train shows in each state, and the excess of each after the regression."""
    shown, likely = [], []
    for train in trains:
        places = [(frozenset(each.structure.passages()), cell) for each, cell in states]
        shown.append([voted(train, *place, 0) for place in places])
        soft = [voted(train, *place, 2) for place in places]
        likely.append([0 if votes is None else int(np.argmax(votes)) for votes in soft])
    modes = [
        np.argmax(np.sum([each[state] for each in shown if each[state]], axis=0).round(3))
        for state in range(len(states))
    ]
    means = []
    for own in range(len(trains)):
        sums, count = np.zeros(8), 0
        for state in range(len(states)):
            others = [each[state] for at, each in enumerate(shown) if at != own and each[state]]
            if shown[own][state] is None or not others:
                continue
            usual = np.mean(others, axis=0)
            neighbours = [each[state] for at, each in enumerate(likely) if at != own]
            policies = np.eye(4)[acts[state]], best[state], np.eye(4)[modes[state]]
            learnt = np.eye(4)[neighbours].mean(axis=0)
            followed = np.array([*policies, learnt, *np.eye(4)])
            sums += (followed - usual) @ (np.array(shown[own][state]) - usual)
            count += 1
        means.append(sums / count)
    effects = np.column_stack([np.ones(len(means)), np.array(means)[:, 1:]])
    own_means = np.array(means)[:, 0]
    return shown, own_means - effects @ np.linalg.pinv(effects) @ own_means


class Made(NamedTuple):
    """A dataset, and its test."""

    folder: Path
    config: DatasetConfig
    test: LabyrinthArrays

    @property
    def data(self) -> Dataset:
        return Dataset(self.folder, self.config.name)


@pytest.fixture(scope="module")
def made(build: Build, tmp_path_factory: pytest.TempPathFactory) -> Made:
    return make(build, tmp_path_factory, size="4", labyrinths=20)


def make(build: Build, temporary: pytest.TempPathFactory, **options: Any) -> Made:
    run = build(temporary.mktemp("made") / "labyrinth", random_steps=1, **options)
    folder = run.folder.parent
    test = load_arrays(folder, run.dataset.name, "test", observation="vector")
    return Made(folder, run.dataset, test)


def copier(made: Made) -> Table:
    """Return a policy that acts as train does most often in the same surroundings."""
    train = load_arrays(made.folder, made.config.name, "train", observation="vector")
    return Table(made.test, local_walls(train, made.test))


def solver(made: Made) -> Table:
    return Table(made.test, made.test.optimal.argmax(axis=1))


def test_twins_and_excess_agree_with_those_of_plain_loops(
    made: Made, build: Build, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folders = [made.folder]
    for seed in range(2**62, 2**62 + CONTROLS):
        options = {"size": "4", "labyrinths": 20, "random_steps": 1, "seed": seed}
        folders.append(build(tmp_path_factory.mktemp("control") / "d", **options).folder.parent)
    policy, test = copier(made), made.test
    live = np.flatnonzero(~test.terminal)
    states = [(test.labyrinths[test.labyrinth[at]], int(test.position[at])) for at in live]
    acts = policy(np.asarray(test.observations)[live]).tolist()
    best = (test.optimal / np.maximum(test.optimal.sum(axis=1, keepdims=True), 1))[live].tolist()
    shown, excess = oracle(states, [*map(demonstrations, folders)], acts, best)

    sets = [train_set(made.config), *control_sets(made.config, CONTROLS)]
    found = Twins.of(test, live, Demonstrated.of(sets)).shown
    expected = [[[np.nan] * 4 if each is None else each for each in one] for one in shown]
    assert np.allclose(found, expected, atol=1e-6, equal_nan=True)
    receipt = memorised(policy, made.data, observation="vector", controls=CONTROLS)
    figures = (100 * excess[0], 100 * excess[1:].mean(), 100 * excess[1:].std(ddof=1))
    assert (receipt.excess, *receipt.controls) == pytest.approx(figures, abs=1e-3)
    assert receipt.p == (1 + (excess[1:] >= excess[0]).sum()) / (1 + CONTROLS)
    assert (receipt.states, receipt.without_twin) == (len(live), shown[0].count(None))


def test_each_copy_is_a_state_of_train_that_looks_most_alike(made: Made) -> None:
    receipt = memorised(copier(made), made.data, observation="vector", controls=CONTROLS)
    train = demonstrations(made.folder)
    of = {
        f"{number:016x}": each
        for number, each in zip(made.test.labyrinth_ids.tolist(), made.test.labyrinths, strict=True)
    }
    assert len(receipt.copies) == len({copy.labyrinth for copy in receipt.copies}) > 5
    for copy in receipt.copies:
        passages = frozenset(of[copy.labyrinth].structure.passages())
        assert copy.shown == pytest.approx(voted(train, passages, copy.agent, 0), abs=1e-4)
        there = [len(passages ^ each) for each, cell, _ in train if cell == copy.agent]
        assert len(copy.passages) == copy.differences == min(there)
        assert copy.twins == there.count(min(there))
        assert passages.symmetric_difference(copy.passages) in [each for each, *_ in train]


@pytest.mark.parametrize("action", range(4))
def test_a_constant_policy_remembers_nothing_whatever_its_train(made: Made, action: int) -> None:
    policy = Table(made.test, np.full(len(made.test.terminal), action))
    receipt = memorised(policy, made.data, observation="vector", controls=CONTROLS)
    assert receipt.excess == pytest.approx(0, abs=1e-3)
    assert receipt.p == receipt.own_way.p == 1
    assert "-0.00" not in repr(receipt) + repr(replace(receipt, excess=-0.001))


def test_interval_and_most_bracket_the_excess(made: Made) -> None:
    receipt = memorised(copier(made), made.data, observation="vector", controls=CONTROLS)
    for each in (receipt, receipt.own_way):
        assert each.interval[0] < each.excess < each.interval[1]
    assert receipt.excess < receipt.most
    assert receipt.own_way.states < receipt.states


@pytest.mark.slow  # 8 s: 100 training sets of 5x5, and 60 simulated policies.
def test_p_is_uniform_without_copying_and_small_with_it(
    build: Build, tmp_path_factory: pytest.TempPathFactory
) -> None:
    made = make(build, tmp_path_factory, size="5", labyrinths=100)
    test, live = made.test, np.flatnonzero(~made.test.terminal)
    sets = [train_set(made.config), *control_sets(made.config, 100)]
    twins = Twins.of(test, live, Demonstrated.of(sets))
    references = [twins.excess(each) for each in module.references_of(twins, test.optimal[live])]
    consensus = twins.shown.mean(axis=0, dtype=np.float64)
    usual = np.eye(4)[consensus.argmax(axis=1)]
    rng = np.random.default_rng(0)

    def ranks(copied: float, otherwise: NDArray[np.float64], count: int) -> NDArray[np.float64]:
        found = []
        for _ in range(count):
            own = rng.integers(len(sets))  # Any of the sets may be the real one.
            copies = rng.random((len(live), 1)) < copied
            shares = np.where(copies, twins.shown[own], otherwise).cumsum(axis=1)
            actions = (rng.random((len(live), 1)) * shares[:, -1:] > shares).sum(axis=1)
            rest = without_effects(twins.excess(np.eye(4)[actions]), references)
            found.append((mean_of(rest) >= mean_of(rest)[own]).mean())
        return np.sort(found)

    without, steps = ranks(0, consensus, 40), np.arange(41) / 40
    apart = max(np.abs(without - steps[1:]).max(), np.abs(without - steps[:-1]).max())
    assert apart < 1.36 / np.sqrt(40), "Kolmogorov and Smirnov, at 5%"
    assert (ranks(0.05, usual, 20) <= 0.05).mean() >= 0.9


OPTIONS = [
    {"size": "4", "task": "partial_observability"},
    {"size": "4", "task": "key_and_door"},
    {"size": "4", "task": "icy_floor"},
    {"size": "3x5"},
    {"size": "4", "goals": "varied"},
    {"size": "4", "solutions": "all"},
]


@pytest.mark.parametrize("options", OPTIONS, ids=lambda options: "-".join(options.values()))
def test_copies_are_found_in_every_kind_of_dataset(
    build: Build, tmp_path_factory: pytest.TempPathFactory, options: dict[str, str]
) -> None:
    made = make(build, tmp_path_factory, labyrinths=10, **options)
    live = np.flatnonzero(~made.test.terminal)
    sets = Demonstrated.of([train_set(made.config)])
    actions = np.zeros(len(made.test.terminal), np.int64)
    actions[live] = np.nan_to_num(Twins.of(made.test, live, sets).shown[0]).argmax(axis=1)
    policy = Table(made.test, actions)
    # After ten controls alone, the regression leaves little.
    follows = memorised(policy, made.data, observation="vector", controls=20)
    solves = memorised(solver(made), made.data, observation="vector", controls=20)
    assert follows.p == 1 / 21
    assert follows.excess > 10 * abs(solves.excess)
    assert follows.states == len(live)


def test_every_kind_of_policy_has_a_receipt(made: Made) -> None:
    table = copier(made)

    class Model:
        """A model as of Stable-Baselines3, without memory."""

        observation_space = type("Space", (), {"sample": lambda _: made.test.observations[0]})()

        def predict(self, observation: Any, *, state: Any = None, deterministic: bool = False):
            assert state is None
            assert deterministic
            return table(observation if observation.ndim == 2 else observation[None]), None

    def asked(policy: Any, **options: Any) -> Any:
        return memorised(
            policy, made.folder, "4x4", observation="vector", controls=CONTROLS, **options
        )

    plain = asked(table)
    assert plain.everywhere
    assert asked(Model()) == plain
    remembering = asked(Remembering(table))
    assert not remembering.everywhere
    # Playing on, it sees the same states as the function.
    assert remembering.own_way == plain.own_way
    assert remembering.excess == plain.own_way.excess
    assert not asked(Rounds(2)).everywhere
    drawn = asked(chance, episodes=3)
    assert drawn.everywhere
    assert drawn == asked(chance, episodes=3)
    assert drawn != asked(chance, episodes=3, seed=1)
    assert not asked(Chance(), episodes=2).everywhere
    pictures = memorised(
        lambda pictures: np.zeros(len(pictures), np.int64), made.data, controls=CONTROLS
    )
    assert pictures.everywhere
    assert "Does the policy follow its own train?" in repr(plain)


def test_a_run_on_some_labyrinths_is_compared_with_as_many(made: Made) -> None:
    policy = solver(made)
    some = memorised(policy, made.data, observation="vector", controls=CONTROLS, train_labyrinths=5)
    whole = memorised(policy, made.data, observation="vector", controls=CONTROLS)
    assert some.without_twin > whole.without_twin
    sets = Demonstrated.of([train_set(replace(made.config, labyrinths=5))])
    live = np.flatnonzero(~made.test.terminal)
    assert some.without_twin == np.isnan(Twins.of(made.test, live, sets).shown[0, :, 0]).sum()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"split": "s0"}, "split='s0': give one of test, validation, which do not depend on train"),
        ({"split": "train"}, "split='train': give one of"),
        ({"controls": 9}, "controls=9: give a whole number from 10 to 10000"),
        ({"train_labyrinths": 21}, "train_labyrinths=21: give a whole number from 1 to 20"),
        ({"episodes": 0}, "episodes=0"),
        ({"config": "4x4"}, "config='4x4': leave it out"),
    ],
    ids=str,
)
def test_a_wrong_argument_is_refused(made: Made, given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=r"^[^\n]+$") as error:
        memorised(solver(made), made.data, observation="vector", **given)
    assert message in str(error.value)


def test_datasets_whose_train_could_be_no_other_are_refused(
    build: Build, tmp_path: Path, made: Made, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(folder: Path, name: str, **options: Any) -> str:
        with pytest.raises(ValueError, match=r"^[^\n]+$") as error:
            memorised(lambda seen: seen, folder, name, **options)
        return str(error.value)

    build(tmp_path / "apart", size="4", labyrinths=5, splits=SplitsConfig(2), random_steps=1)
    assert "splits.min_walls=2" in refused(tmp_path / "apart", "4x4")
    build(tmp_path / "many", size="3", labyrinths=90, random_steps=1)
    assert "give at most 50%" in refused(tmp_path / "many", "3x3", controls=CONTROLS)
    some = memorised(
        lambda seen: np.zeros(len(seen)).astype(int),
        *(tmp_path / "many", "3x3"),
        controls=CONTROLS,
        train_labyrinths=32,
    )
    assert 0.1 < some.shared < 0.4
    monkeypatch.setattr(module, "MOST_BYTES", 10**5)
    assert "give fewer controls" in refused(made.folder, made.config.name, controls=CONTROLS)
    monkeypatch.setattr(module, "train_set", lambda config: (config, []))
    assert "its train is not what its config draws" in refused(made.folder, made.config.name)


def test_an_error_of_the_policy_is_one(made: Made) -> None:
    with pytest.raises(PolicyError, match="answered"):
        memorised(lambda seen: seen, made.data, controls=CONTROLS)
