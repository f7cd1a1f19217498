"""Anybody's policy judged: looking up, stepping and the environment agree; mistakes are told."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support.labyrinths_of_datasets import CONFIGS
from support.policies import Chance, Remembering, Rounds, Table, chance, mistaken

from labyrinth_core import PolicyError, compare, dump, evaluate, hub, load_arrays
from labyrinth_core.data import SPLITS, Manifest
from labyrinth_core.env import LabyrinthEnv
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Player, Results, playing
from labyrinth_core.evaluation.scores import Episodes, Scores
from labyrinth_core.pictures import Looks
from labyrinth_core.world import Task

every_config = pytest.mark.parametrize("config", CONFIGS.values())


@pytest.fixture(scope="module")
def arrays_of(datasets):
    return {
        (config, split): load_arrays(datasets, config, split, image_size=8)
        for config in CONFIGS.values()
        for split in SPLITS.evaluated
    }


def told(scores):
    """Return all that looking up and stepping should agree on."""
    figures = scores.figures()
    for name in ("accuracy_on_demonstrations", "accuracy_elsewhere"):
        del figures[name]
    episodes = scores.episodes
    return figures, episodes.outcomes.ravel().tolist(), episodes.moves.ravel().tolist()


def stepped(policy, arrays):
    return Scores.of(Player.of(policy).step_through(arrays, 1), arrays)


# Both ways.


@pytest.mark.slow
@given(
    config=st.sampled_from([*CONFIGS.values()]),
    split=st.sampled_from(SPLITS.evaluated),
    share=st.floats(0, 1),
    seed=st.integers(0, 2**32 - 1),
)
def test_stepping_gives_the_figures_of_looking_up(arrays_of, config, split, share, seed):
    arrays = arrays_of[config, split]
    policy = Table(arrays, mistaken(arrays, share, seed))
    looked_up = told(Player.of(policy).score(arrays))
    assert told(stepped(policy, arrays)) == looked_up
    assert told(stepped(Remembering(policy), arrays)) == looked_up


def roll_out(policy, labyrinth):
    """Return the rewards of an episode in the environment, and how it ends."""
    env = LabyrinthEnv(labyrinth=labyrinth, image_size=8)
    observation, _ = env.reset(seed=0)
    policy.reset(1)
    rewards, states, over = [], [], False
    while not over:
        action = policy.act(observation[None])[0]
        observation, reward, terminated, truncated, _ = env.step(action)
        rewards.append(reward)
        states.append(env.state)
        over = terminated or truncated
    cut = "wall" if len({*states[len(states) // 2 :]}) == 1 else "loop"
    return rewards, {1: "solved", -100: "ice"}.get(rewards[-1], cut)


@every_config
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0, None])
def test_a_policy_does_what_it_does_in_the_environment(arrays_of, config, share):
    arrays = arrays_of[config, "train"]
    if share is None:
        policy = Rounds(3)
        episodes = stepped(policy, arrays).episodes
    else:
        policy = Remembering(Table(arrays, mistaken(arrays, share)))
        episodes = Player.of(policy.act).score(arrays).episodes
    for place, labyrinth in enumerate(arrays.labyrinths):
        rewards, outcome = roll_out(policy, labyrinth)
        assert episodes.outcomes[..., place] == outcome
        assert episodes.moves[..., place] == len(rewards)
        assert episodes.returns[..., place] == pytest.approx(sum(rewards), abs=1e-9)
        assert episodes.solved[..., place] == (rewards[-1] == 1)
    if share == 0:
        assert episodes.solved.all()
        assert (episodes.moves == arrays.distance).all()


@every_config
def test_an_attempt_takes_the_steps_of_the_episode_that_is_judged(arrays_of, config):
    arrays = arrays_of[config, "test"]
    random, optimal = (Table(arrays, mistaken(arrays, share)) for share in (1.0, 0.0))
    for policy in (random, optimal, Remembering(random), Rounds(2)):
        player = Player.of(policy, 0)
        judged = player.step_through(arrays, 1)
        tried = player.attempts(arrays, range(len(arrays.labyrinths)))
        for place, episode in enumerate(tried):
            moves, outcome = judged.moves[0, place], judged.outcomes[0, place]
            assert len(episode) == min(moves, arrays.cells)
            if moves <= arrays.cells:
                reached = episode.states[-1].agent == episode.labyrinth.goal
                assert reached == (outcome == "solved")


def test_many_labyrinths_are_stepped_some_at_a_time(arrays_of, monkeypatch):
    arrays = arrays_of["3x4", "train"]
    at_once = told(stepped(Rounds(2), arrays))
    monkeypatch.setattr(playing, "TOGETHER", 2)
    assert told(stepped(Rounds(2), arrays)) == at_once


def test_what_a_policy_that_remembers_says_of_episodes_that_are_over_is_not_looked_at(arrays_of):
    arrays = arrays_of["3x4", "train"]
    best = Table(arrays, np.where(arrays.terminal, 99, mistaken(arrays, 0)))
    assert stepped(Remembering(best), arrays).sr == 1


def test_a_function_is_asked_no_more_about_episodes_that_are_over(arrays_of):
    arrays = arrays_of["3x4", "train"]
    policy, asked = Table(arrays, mistaken(arrays, 0)), []
    stepped(lambda seen: asked.append(len(seen)) or policy(seen), arrays)
    assert sum(asked) == arrays.distance.sum()


def test_the_pictures_of_states_are_held_only_for_policies_that_are_stepped(datasets, monkeypatch):
    held = []
    monkeypatch.setattr(Looks, "held", lambda looks: held.append(len(looks)) or looks)

    def rightwards(observations):
        return np.ones(len(observations), np.int64)

    looked_up = evaluate(rightwards, datasets, "3x4", image_size=8)
    assert not held
    steps = evaluate(rightwards, datasets, "3x4", image_size=8, episodes=1)
    assert len(held) == len(steps.splits)
    for name, each in steps.splits.items():
        assert told(each) == told(looked_up.splits[name])


# Chance.


@pytest.mark.slow
def test_a_policy_that_draws_at_random_comes_to_its_expectation(datasets):
    results = evaluate(chance, datasets, "3x4", image_size=8, splits=["train"], episodes=300)
    scores, exact = results.splits["train"], results.baselines["random"]["train"]
    assert scores.episodes.outcomes.shape == (300, 5)
    assert scores.sr == pytest.approx(exact["sr"], abs=0.02)
    assert scores.aer == pytest.approx(exact["aer"], abs=0.1)
    assert "300 episodes per labyrinth, by steps" in str(results)


@pytest.mark.parametrize("make", [lambda: chance, Chance])
def test_the_seed_settles_what_is_drawn(datasets, make):
    def moves(seed):
        results = evaluate(make(), datasets, "3x4", image_size=8, splits=["test"], seed=seed)
        assert results.way == "steps"
        return results.splits["test"].episodes.moves.tolist()

    assert moves(1) == moves(1)
    assert moves(1) != moves(2)


# What is shown, and what may be answered.


class Network(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.shown = []
        self.dropout = torch.nn.Dropout(0.9)
        self.frozen = torch.nn.Dropout(0.9).eval()
        self.last = torch.nn.Linear(8 * 8 * 3, 4)

    def forward(self, observations):
        self.shown.append((observations.dtype, self.training, torch.is_grad_enabled()))
        return self.last(self.frozen(self.dropout(observations.flatten(1).float())))


def test_a_module_is_given_tensors_and_left_as_it_was(datasets):
    torch.manual_seed(0)
    network = Network()
    by_module = evaluate(network, datasets, "3x4", image_size=8, splits=["test"])
    assert network.shown
    assert set(network.shown) == {(torch.uint8, False, False)}
    assert [each.training for each in network.modules()] == [True, True, False, True]
    network.eval()

    def function(observations):
        return network(torch.tensor(observations)).detach().numpy()

    by_function = evaluate(function, datasets, "3x4", image_size=8, splits=["test"])
    assert told(by_module.splits["test"]) == told(by_function.splits["test"])


class Foreign:
    """An array of a library that is not numpy, such as JAX."""

    def __init__(self, array):
        self.array = array

    def __array__(self, dtype=None, copy=None):
        return self.array


@pytest.mark.parametrize(
    "answer",
    [
        lambda actions: actions,
        lambda actions: actions.tolist(),
        lambda actions: actions.astype(np.uint8),
        lambda actions: Foreign(actions),
        lambda actions: torch.tensor(actions),
        lambda actions: np.eye(4)[actions],
        lambda actions: Foreign(np.eye(4, dtype=np.float32)[actions]),
        lambda actions: np.log(np.eye(4, dtype=np.float16)[actions]),
        lambda actions: torch.eye(4, requires_grad=True)[torch.tensor(actions)],
        lambda actions: torch.eye(4, dtype=torch.bfloat16)[torch.tensor(actions)],
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero")
def test_actions_and_scores_of_any_library_are_understood(arrays_of, answer):
    arrays = arrays_of["3x4", "test"]
    table = Table(arrays, mistaken(arrays, 0.3))
    expected = Player.of(table).score(arrays)
    found = Player.of(lambda seen: answer(table(seen))).score(arrays)
    assert told(found) == told(expected)
    assert found.accuracy_elsewhere == expected.accuracy_elsewhere
    assert told(stepped(lambda seen: answer(table(seen)), arrays)) == told(expected)


def test_texts_are_the_labyrinth_in_the_language_with_the_agent_in_it(datasets):
    shown = []

    def policy(texts):
        assert {type(each) for each in texts} == {str}
        shown.extend(texts)
        return [0] * len(texts)

    results = evaluate(policy, datasets, "3x4", observation="text", splits=["test"])
    assert results.image_size is None
    assert "text, one episode per labyrinth, by look-ups" in str(results)
    begins = {dump(each) for each in load_arrays(datasets, "3x4", "test").labyrinths}
    assert begins < {text.replace("@", "S") for text in shown}


# What is refused.


def broken(seen):
    raise OSError(f"no such\nlayer for {len(seen)}")


class UnprintableError(Exception):
    def __str__(self):
        raise RuntimeError


class Raising:
    """What fails in whatever is done with it."""

    def fail(self, *_, **__):
        raise UnprintableError

    __array__ = fail
    __len__ = fail


@pytest.mark.slow
@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (broken, r"raised OSError: no such layer for 48 when given uint8 of shape \(48, 8, .*\)\Z"),
        (lambda seen: seen[:3, 0, 0, 0], r"answered uint8 of shape \(3,\) to 48 obs"),
        (lambda seen: np.zeros((len(seen), 5)), r"answered float64 of shape \(48, 5\) to 48 obs"),
        (lambda seen: np.zeros((len(seen), 1), int), r"answered int64 of shape \(48, 1\) to 48"),
        (lambda seen: np.zeros(len(seen)), r"answered float64 of shape \(48,\) .* whole numbers"),
        (lambda seen: np.full(len(seen), 7), "answered action 7: give 0 up, 1 right, 2 down or 3"),
        (lambda seen: np.full(len(seen), -1), "answered action -1: give 0 up"),
        (lambda seen: np.full((len(seen), 4), np.nan), "answered nan as the score of an action"),
        (lambda seen: np.ma.masked_less(np.eye(4)[seen[:, 0, 0, 0] % 4], 1), "a masked array: giv"),
        (lambda seen: seen.sort(), "answered NoneType to 48 observations"),
        (lambda seen: ["up"] * len(seen), r"answered <U2 of shape \(48,\) to 48 observations"),
        (lambda seen: (seen, [1, 2], None), "answered tuple, which is not an array"),
        (lambda seen: torch.zeros(len(seen), 4, device="meta"), "answered Tensor, which is not "),
        (lambda _: Raising(), "answered Raising, which is not an array"),
        (lambda _: Raising().fail(), "raised UnprintableError: UnprintableError when given uint8"),
        (lambda _: sys.exit(0), "raised SystemExit: 0 when given uint8"),
    ],
)
def test_a_broken_policy_is_told_what_came_back_and_what_is_wanted(datasets, policy, message):
    with pytest.raises(PolicyError, match=message) as caught:
        evaluate(policy, datasets, "3x4", image_size=8)
    assert "\n" not in str(caught.value)
    if policy is broken:
        assert type(caught.value.__cause__) is OSError


@pytest.mark.parametrize(
    ("memory", "message"),
    [
        (None, "NoneType: give an array with a row for each of the 5 episodes"),
        ([object()] * 5, "list: give an array"),
        ([[1], [2, 3]] * 5, "list, which is not an array"),
        (np.zeros(4), r"float64 of shape \(4,\): give an array"),
        (7, r"int64 of shape \(\): give"),
    ],
)
def test_what_is_remembered_is_an_array_with_a_row_for_each_episode(arrays_of, memory, message):
    policy = Rounds(1)
    policy.remembered = lambda: memory
    with pytest.raises(PolicyError, match=rf"\Aremembered\(\) answered {message}"):
        stepped(policy, arrays_of["3x4", "train"])


def test_what_is_remembered_may_be_a_tensor_or_lists(arrays_of):
    arrays = arrays_of["3x4", "train"]
    expected = told(stepped(Rounds(1), arrays))
    for kind in (torch.as_tensor, np.ndarray.tolist):
        policy = Rounds(1)
        policy.remembered = lambda policy=policy, kind=kind: kind(policy.steps % 4)
        assert told(stepped(policy, arrays)) == expected


def test_a_policy_that_is_random_in_one_of_fifty_answers_is_refused(small_dataset):
    rng = np.random.default_rng(0)

    def policy(vectors):
        return np.where(rng.random(len(vectors)) < 0.02, rng.integers(4, size=len(vectors)), 1)

    for _ in range(20):
        with pytest.raises(PolicyError, match="answers the same observations differently"):
            evaluate(policy, small_dataset.data_dir, "3x3", observation="vector")


@pytest.mark.parametrize(
    "policy",
    [
        lambda vectors: (vectors - vectors.mean(axis=0) > 0).sum(axis=1) % 4,  # As BatchNorm does.
        lambda vectors: np.arange(len(vectors)) % 4,
        lambda vectors: np.full(len(vectors), len(vectors) % 4),
        lambda vectors: np.roll(vectors.sum(axis=1) % 4, 1),
    ],
    ids=["mean", "place", "size", "neighbour"],
)
def test_a_policy_whose_answers_depend_on_the_batch_is_refused(small_dataset, policy):
    with pytest.raises(PolicyError, match=r"observations differently in another batch: give one"):
        evaluate(policy, small_dataset.data_dir, "3x3", observation="vector")


def test_a_policy_whose_sums_round_otherwise_in_another_batch_is_judged(small_dataset):
    arrays = load_arrays(small_dataset.data_dir, "3x3", "test", observation="vector")
    (close,) = arrays.observations[~arrays.terminal][:1].tolist()

    def policy(vectors):
        return ((vectors == close).all(axis=1) & (len(vectors) % 3 == 0)).astype(int)

    assert evaluate(policy, small_dataset.data_dir, "3x3", observation="vector").way == "look-ups"


@pytest.mark.parametrize(
    ("policy", "message"), [(Rounds, "not the class Rounds"), (object(), "not an object of object")]
)
def test_what_is_no_policy_is_refused(datasets, policy, message):
    with pytest.raises(PolicyError, match=rf"\Apolicy: give a function from .*, {message}\Z"):
        evaluate(policy, datasets, "3x4")


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"episodes": 0}, ValueError, "episodes=0: give a whole number from 1 to 1000"),
        ({"episodes": 1001}, ValueError, "episodes=1001: give a whole"),
        ({"seed": "a"}, ValueError, "seed='a': give a whole number from 0 to 18446744073709551615"),
        ({"observation": "sound"}, ValueError, "observation=sound: choose one of image, vector"),
        ({"splits": ["tset"]}, DatasetError, "split=tset: the dataset has train, validation, test"),
        ({"splits": []}, DatasetError, r"split=\[\]: the dataset has train"),
        ({"splits": 5}, ValueError, r"splits=5: give names such as \['test'\]"),
        ({"source": 5}, ValueError, "source=5: give a folder, or an id such as user/labyrinth"),
        ({"config": 5}, ValueError, "config=5: give a name, such as '5x5'"),
        ({"revision": "1"}, ValueError, "revision=1: .* is a folder, which has no revisions"),
    ],
)
def test_an_impossible_argument_is_told_in_one_line(datasets, options, kind, message):
    with pytest.raises(kind, match=rf"\A{message}"):
        evaluate(chance, **{"source": datasets, "config": "3x4"} | options)


# The dataset, and the results.


def test_a_seed_may_be_a_number_of_numpys(datasets, tmp_path):
    options = {"image_size": 8, "splits": ["test"]}
    results = evaluate(chance, datasets, "3x4", seed=np.int64(3), episodes=np.int8(2), **options)
    results.save(tmp_path / "mine.json", name="mine")
    assert Results.load(tmp_path / "mine.json").seed == 3
    assert str(results) == str(evaluate(chance, datasets, "3x4", seed=3, episodes=2, **options))


def test_all_splits_but_the_random_one_are_evaluated(datasets):
    results = evaluate(Rounds(1), datasets, "3x4", image_size=8)
    assert tuple(results.splits) == SPLITS.evaluated
    assert results.fingerprint == Manifest.read(datasets / "3x4").fingerprint
    policys, failed, beside = results.tables().split("\n\n")
    tables = policys.splitlines()[3:], failed.splitlines()[2:], beside.splitlines()[2:]
    for table in tables:
        assert [line.split()[0] for line in table] == list(SPLITS.evaluated)
    assert evaluate(Rounds(1), datasets, "3x4", image_size=8, splits="random").splits


def test_a_dataset_on_the_hub_is_read_at_the_commit_of_its_revision(datasets, monkeypatch):
    asked = []

    def download(source, _repo_type, commit, names):
        asked.append((source, commit, *names))
        return datasets

    monkeypatch.setattr(hub, "commit_of", lambda _source, _repo_type, revision: f"{revision} now")
    monkeypatch.setattr(hub, "download", download)
    options = {"revision": "v1", "image_size": 8, "splits": ["test"]}
    results = evaluate(Rounds(1), "user/name", "3x4", **options)
    assert (results.dataset, results.revision) == ("user/name", "v1")
    assert {each[:2] for each in asked} == {("user/name", "v1 now")}
    files = {name.rpartition("/")[2] for _, _, *names in asked for name in names}
    shards = {f"{split}-00000-of-00001.parquet" for split in ("train", "test")}
    assert files == {"manifest.json", *shards}


# What it says that it has to be shown.


class Stating:
    """A policy that says what it has to be shown, and keeps what it is told."""

    def __init__(self, **stated):
        self.seen, self.told = set(), []
        vars(self).update(stated)

    def for_labyrinths(self, height, width, task):
        self.told.append((height, width, str(task)))
        return self

    def __call__(self, observations):
        self.seen.add("text" if isinstance(observations, list) else observations.shape[1:])
        return np.ones(len(observations), int)


@pytest.mark.parametrize(
    ("stated", "options", "seen"),
    [
        ({}, {}, (64, 64, 3)),
        ({"image_size": 20}, {}, (20, 20, 3)),
        ({"image_size": np.int64(20)}, {"image_size": 20}, (20, 20, 3)),
        ({"image_size": lambda height, width: 2 * height + width}, {}, (10, 10, 3)),
        ({"observation": "vector", "image_size": None}, {}, (38,)),
        ({"observation": "text"}, {"observation": "text"}, "text"),
        ({"observation": np.zeros(3), "resize": str.lower}, {"image_size": 8}, (8, 8, 3)),
    ],
)
def test_a_policy_is_shown_what_it_says_and_told_the_labyrinths(datasets, stated, options, seen):
    policy = Stating(**stated)
    results = evaluate(policy, datasets, "3x4", splits=["test"], **options)
    assert policy.seen == {seen}
    assert policy.told == [(3, 4, "navigation")]
    size = seen[0] if len(seen) == 3 else None
    kind = seen if seen == "text" else "vector" if size is None else "image"
    assert (results.observation, results.image_size) == (kind, size)
    pairs = {name: (value, None) for name, value in options.items()}
    compare(policy, Stating(), datasets, "3x4", most=1, **pairs)
    assert policy.seen == {seen}


@pytest.mark.parametrize(
    ("stated", "options", "message"),
    [
        (
            {"observation": "vector"},
            {"observation": "image"},
            "needs observation=vector, but is",
        ),
        (
            {"image_size": 20},
            {"image_size": 64},
            "image_size=20 at 3x4, but is shown image_size=64",
        ),
        ({"image_size": 601}, {}, "the policy asks for image_size=601 at 3x4: a whole number"),
        ({"image_size": (9, 9)}, {}, r"asks for image_size=\(9, 9\) at 3x4: a whole number of pix"),
        ({"image_size": lambda side: side}, {}, "the policy raised TypeError: "),
        ({"for_labyrinths": lambda *_: 1 / 0}, {}, "the policy raised ZeroDivisionError: "),
        ({"observation": "smell"}, {}, "observation=smell: choose one of image, vector, text"),
    ],
)
def test_what_a_policy_says_is_followed_or_refused_in_one_line(datasets, stated, options, message):
    for call in (
        lambda: evaluate(Stating(**stated), datasets, "3x4", **options),
        lambda: compare(chance, Stating(**stated), datasets, "3x4", **options),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            call()
        assert "\n" not in str(caught.value)


# What is printed.


def failing(scores):
    """Return scores in which episodes end in all ways."""
    moves, count = scores.episodes.moves, len(scores.distance)
    outcomes = np.resize(["solved", "loop", "wall", "ice"], (12, count))
    episodes = Episodes(outcomes, np.resize(moves, (12, count)), scores.episodes.cells)
    return replace(scores, episodes=episodes)


@pytest.mark.parametrize("splits", [SPLITS.evaluated, tuple(SPLITS)])
@pytest.mark.parametrize("blind", [False, True])
def test_tables_fit_a_terminal_and_cut_no_name_and_the_legend_is_printed_once(
    datasets, splits, blind
):
    results = evaluate(chance, datasets, CONFIGS[Task.PARTIAL_OBSERVABILITY], splits=["test"])
    scores = failing(results.splits["test"])
    figures = dict.fromkeys(("spl", "sr"), 1.0)
    names = [*Results.WITHOUT_LEARNING] if blind else [*results.baselines]
    wide = replace(
        results,
        splits=dict.fromkeys(splits, scores),
        baselines={name: dict.fromkeys(splits, figures) for name in names},
    )
    place, *lines = str(wide).splitlines()
    assert place == f"3x4-partial_observability of {datasets}"
    assert max(map(len, lines)) <= 80
    for split in splits:
        shown = [line.split()[1:] for line in lines if line.startswith(f"{split} ")]
        assert 3 <= len(shown) <= 4, shown
        assert sum(map(len, shown)) == 9 + 3 + len(names) - 1  # AER is three words.
    assert sum("success weighted by path length" in line for line in lines) == 1
    assert str(wide) == "\n".join([wide.tables(), "", *wide.legend()])
    headings = " ".join(line for line in lines if line.startswith((" ", "split"))).split()
    words = {word for name in names for word in name.replace("_", " ").split()} - {"oracle"}
    assert words | {"loop", "wall", "ice"} <= set(headings)
    failed = f"{(outcomes := scores.episodes.outcomes)[outcomes == 'loop'].size}"
    assert any(line.split()[:2] == [splits[0], failed] for line in lines)
