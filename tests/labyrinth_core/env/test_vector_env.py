"""The vector environment: the same as single environments, only many at once."""

import tracemalloc
from copy import deepcopy
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from support.known_labyrinths import OPEN
from support.known_labyrinths import SMALL_KEY_AND_DOOR as KEY_AND_DOOR

from labyrinth_core.env import LabyrinthEnv
from labyrinth_core.env.vector_env import LabyrinthVectorEnv
from labyrinth_core.language import dump, parse
from labyrinth_core.pictures import render
from labyrinth_core.world import BatchSampler, Look, Task, sample_labyrinth

NAME = "labyrinth_core.env:Labyrinth-v0"
CLOSER = OPEN.replace("|     E |", "| E     |")


def assert_same(ours, theirs, where=""):
    """Check that values, types and keys are the same, however deeply they are nested."""
    assert type(ours) is type(theirs), where
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys(), where
        for key in ours:
            assert_same(ours[key], theirs[key], f"{where}.{key}")
    elif isinstance(ours, tuple):
        for place, (our, their) in enumerate(zip(ours, theirs, strict=True)):
            assert_same(our, their, f"{where}[{place}]")
    elif isinstance(ours, np.ndarray):
        assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape), where
        if ours.dtype == object:
            assert_same(tuple(ours), tuple(theirs), where)
        else:
            np.testing.assert_array_equal(ours, theirs, where)
    else:
        assert ours == theirs, where


def pair(num_envs, mode=AutoresetMode.NEXT_STEP, **arguments):
    """Return a vector environment and Gymnasium's own of as many single ones."""
    return (
        LabyrinthVectorEnv(num_envs, autoreset_mode=mode, **arguments),
        SyncVectorEnv(
            [lambda: LabyrinthEnv(**arguments) for _ in range(num_envs)], autoreset_mode=mode
        ),
    )


def both(envs, call):
    """Check that a call gives the same on both, and return what it gives."""
    ours, theirs = (call(env) for env in envs)
    assert_same(ours, theirs)
    return ours


@pytest.mark.slow
@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("task", Task)
@pytest.mark.parametrize("kind", ["image", "vector", "state"])
def test_every_step_is_that_of_single_environments(mode, task, kind):
    steps, count = (120, 3) if kind == "image" else (150, 4)
    envs = pair(
        count, mode, size=(3, 4), task=task, observation=kind, image_size=16, max_episode_steps=50
    )
    actions = np.random.default_rng(0).integers(4, size=(steps, count))
    both(envs, lambda env: env.reset(seed=11))
    ended = 0
    for action in actions:
        *_, terminated, truncated, _ = both(envs, lambda env, action=action: env.step(action))
        over = terminated | truncated
        ended += over.sum()
        if mode is AutoresetMode.DISABLED and over.any():
            both(envs, lambda env, over=over: env.reset(options={"reset_mask": over.copy()}))
    assert ended >= 2 * count, "the walk must see ends and new beginnings"


@pytest.mark.slow
@pytest.mark.parametrize("task", [Task.NAVIGATION, Task.PARTIAL_OBSERVABILITY])
def test_labyrinths_that_are_drawn_together_are_those_of_single_environments(task):
    count, rng = 130, np.random.default_rng(0)
    envs = pair(count, size=(4, 3), task=task, observation="vector", max_episode_steps=9)
    both(envs, lambda env: env.reset(seed=5))
    for step in range(50):
        action = rng.integers(4, size=count)
        both(envs, lambda env, action=action: env.step(action))
        mask = rng.random(count) < 0.3
        if step % 12 == 5:  # What was drawn ahead must come back after an option.
            options = {"reset_mask": mask, "goal": (1, 1)}
            both(envs, lambda env, options=options: env.reset(options=dict(options)))
        if step % 12 == 11:
            options = {"reset_mask": mask}
            both(envs, lambda env, options=options: env.reset(seed=9, options=dict(options)))


@pytest.mark.slow
def test_a_split_is_that_of_single_environments():
    arguments = {"size": 3, "observation": "state", "split": "train", "buckets": (20, 40, 40)}
    ours, theirs = LabyrinthVectorEnv(130, **arguments), LabyrinthEnv(**arguments)
    texts = ours.reset(seed=7)[1]["labyrinth"], ours.reset()[1]["labyrinth"]
    for place in (0, 1, 129):
        assert theirs.reset(seed=7 + place)[1]["labyrinth"] == texts[0][place]
        assert theirs.reset()[1]["labyrinth"] == texts[1][place]
    assert {parse(text).structure.split((20, 40, 40)) for text in texts[1]} == {"train"}


def test_a_labyrinth_that_has_to_be_drawn_alone_is_not_tried_again_before(monkeypatch):
    tried, sample = 0, BatchSampler.sample

    def none(sampler, generators):
        nonlocal tried
        tried += len(generators)
        return sample(sampler, generators[:0])

    monkeypatch.setattr(BatchSampler, "sample", none)
    envs = pair(128, "SameStep", size=3, observation="state", max_episode_steps=20)
    both(envs, lambda env: env.reset(seed=0))
    begun = 128
    for action in np.random.default_rng(0).integers(4, size=(50, 128)):
        *_, infos = both(envs, lambda env, action=action: env.step(action))
        begun += infos["_final_info"].sum() if "_final_info" in infos else 0
    assert 128 < tried <= begun + 128


@pytest.mark.slow
def test_labyrinths_that_are_drawn_together_are_drawn_into_pictures():
    envs = pair(128, "SameStep", size=3, image_size=8, max_episode_steps=5, reward="normalised")
    both(envs, lambda env: env.reset(seed=0))
    for action in np.random.default_rng(0).integers(4, size=(12, 128)):
        both(envs, lambda env, action=action: env.step(action))


def test_the_spaces_are_those_of_single_environments():
    for task in Task:
        for kind in ("image", "vector", "state"):
            ours, theirs = pair(3, size=(3, 4), task=task, observation=kind)
            for space in ("observation_space", "action_space"):
                assert getattr(ours, space) == getattr(theirs, space)
                assert getattr(ours, f"single_{space}") == getattr(theirs, f"single_{space}")
            assert ours.reset(seed=0)[0] in ours.observation_space


def test_a_kept_labyrinth_stays_also_after_an_option_changed_it_for_an_episode():
    envs = pair(2, labyrinth=OPEN, observation="vector")
    both(envs, lambda env: env.reset(seed=0, options={"start": (0, 1)}))
    both(envs, lambda env: env.step(np.array([0, 3])))
    both(envs, lambda env: env.step(np.array([0, 3])))
    both(envs, lambda env: env.reset())


def test_given_labyrinths_are_dealt_out_in_turn_and_kept():
    given = (text for text in (OPEN, parse(CLOSER)))
    env = LabyrinthVectorEnv(5, labyrinths=given, observation="state")
    env.reset()
    for actions in [(0, 1, 0, 1, 0), (1, 0, 1, 0, 1), (1, 0, 1, 0, 1), (0,) * 5]:
        *_, infos = env.step(np.array(actions))
    texts = [parse(text) for text in infos["labyrinth"]]
    assert texts == [parse(OPEN), parse(CLOSER)] * 2 + [parse(OPEN)]


def test_more_labyrinths_than_sub_environments_come_in_turn_from_the_seed_on():
    rng = np.random.default_rng(0)
    texts = [dump(sample_labyrinth(3, 3, Task.NAVIGATION, rng)) for _ in range(5)]
    env = LabyrinthVectorEnv(2, labyrinths=texts, observation="state", max_episode_steps=1)

    def shown(infos):
        return [texts.index(text) for text in infos["labyrinth"] if text is not None]

    assert shown(env.reset()[1]) == [0, 1]
    env.step(np.array([0, 0]))
    assert shown(env.step(np.array([0, 0]))[-1]) == [2, 3]
    mask = np.array([False, True])
    assert shown(env.reset(options={"reset_mask": mask})[1]) == [0]
    with pytest.raises(ValueError, match="option 'colour'"):
        env.reset(options={"colour": 1})
    assert shown(env.reset()[1]) == [4, 2]
    assert shown(env.reset(seed=9)[1]) == [4, 0]
    assert shown(env.reset()[1]) == [1, 2]


def test_a_single_environment_takes_given_labyrinths_in_turn_as_a_vector_of_one_does():
    rng = np.random.default_rng(0)
    given = [sample_labyrinth(3, 3, Task.NAVIGATION, rng) for _ in range(3)]
    one = LabyrinthEnv(labyrinths=given, observation="state")
    several = LabyrinthVectorEnv(1, labyrinths=given, observation="state")
    for seed in (None, None, None, None, 5, None, np.int64(2), None):
        single, batch = one.reset(seed=seed)[1], several.reset(seed=seed)[1]
        assert single["labyrinth"] == batch["labyrinth"][0]
    before = one.labyrinth
    with pytest.raises(ValueError, match="option 'colour'"):
        one.reset(options={"colour": 1})
    assert parse(one.reset()[1]["labyrinth"]) == given[(given.index(before) + 1) % 3]
    with pytest.raises(ValueError, match="all labyrinths of an environment have one size"):
        LabyrinthEnv(labyrinths=[*given, parse(KEY_AND_DOOR)])


def test_make_vec_finds_it():
    env = gymnasium.make_vec(NAME, autoreset_mode="SameStep")
    assert isinstance(env, LabyrinthVectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


def test_an_episode_that_never_ends_returns_minus_four():
    env = LabyrinthVectorEnv(3, 3, observation="state")
    env.reset(seed=0)
    steps = [env.step(np.array([2, 3, 2])) for _ in range(360)]
    assert not any(truncated.any() for _, _, _, truncated, _ in steps[:-1])
    assert steps[-1][3].all()
    np.testing.assert_allclose(sum(paid for _, paid, *_ in steps), -4.0, atol=1e-9)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("task", ["key_and_door", "icy_floor"])
@pytest.mark.parametrize("kind", ["image", "vector", "state"])
def test_what_was_returned_is_the_callers_own(kind, task, mode):
    options = {"observation": kind, "autoreset_mode": mode, "max_episode_steps": 20}
    ours, untouched = (LabyrinthVectorEnv(3, 3, task, **options) for _ in range(2))
    returned, _ = ours.reset(seed=0), untouched.reset(seed=0)
    kept = []
    for action in np.random.default_rng(0).integers(4, size=(100, 3)):
        for array in [*returned[:-1], *returned[-1].values()]:
            if isinstance(array, np.ndarray) and array.flags.writeable:
                array[:] = 0
        kept.append((returned, deepcopy(returned)))
        returned = ours.step(action)
        assert_same(returned, untouched.step(action))
    for array, as_it_was in kept:
        assert_same(array, as_it_was)


@pytest.mark.slow
@pytest.mark.parametrize("task", Task)
@pytest.mark.parametrize("keeping", [{}, {"copy": False}, {"picture_memory": 40_000}])
def test_pictures_are_those_of_the_renderer_whatever_is_kept(task, keeping):
    rng = np.random.default_rng(0)
    labyrinths = [replace(sample_labyrinth(4, 5, task, rng), look=look) for look in Look]
    options = {"labyrinths": labyrinths, "max_episode_steps": 30}
    env = LabyrinthVectorEnv(4, image_size=48, **options, **keeping)
    beside = LabyrinthVectorEnv(4, observation="state", **options)
    copying = keeping.get("copy", True)
    (first, infos), (numbers, _) = env.reset(seed=0), beside.reset(seed=0)
    shown, phases = first, set()
    for _ in range(40):
        for picture, number, text in zip(shown, numbers, infos["labyrinth"], strict=True):
            phases.add(number // 20)
            labyrinth = parse(text)
            np.testing.assert_array_equal(
                picture, render(labyrinth, labyrinth.state_at(int(number)), 48)
            )
        optimal = infos["optimal_actions"].argmax(axis=1)
        actions = np.where(rng.random(4) < 0.8, optimal, rng.integers(4, size=4))
        (shown, *_, infos), (numbers, *_) = env.step(actions), beside.step(actions)
        assert np.shares_memory(shown, first) is not copying
        assert shown.flags.writeable is copying
    assert phases == ({0, 1, 2} if task is Task.KEY_AND_DOOR else {0})


def test_what_is_kept_of_pictures_takes_no_more_than_the_memory_given():
    memory = []
    for picture_memory in (0, 5 * 3 * 256**2, 10**9):
        tracemalloc.start()
        try:
            env = LabyrinthVectorEnv(9, 5, image_size=256, picture_memory=picture_memory)
            env.reset(seed=0)
            memory.append(tracemalloc.get_traced_memory()[0])
        finally:
            tracemalloc.stop()
            env.close()
    nothing, some, all_of_them = memory
    assert some - nothing <= 5 * 3 * 256**2 < all_of_them - nothing


def test_pictures_and_drawings_are_those_of_single_environments():
    for mode in ("rgb_array", "ansi"):
        envs = pair(2, render_mode=mode, task="partial_observability", observation="state")
        both(envs, lambda env: env.reset(seed=0))
        both(envs, lambda env: env.step(np.array([0, 1])))
        both(envs, lambda env: env.render())
    assert LabyrinthVectorEnv(2).render() is None


def test_steps_outside_an_episode_are_refused():
    env = LabyrinthVectorEnv(3, labyrinth=OPEN, autoreset_mode="Disabled", render_mode="ansi")
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step(np.zeros(3, int))
    with pytest.raises(ResetNeeded, match="call reset"):
        env.render()
    with pytest.raises(ResetNeeded, match="call reset"):
        env.reset(options={"reset_mask": np.array([True, True, False])})
    env.reset()
    env.step(np.array([0, 0, 1]))
    env.step(np.array([1, 0, 0]))
    with pytest.raises(ResetNeeded, match="sub-environments 0, 2 are over"):
        env.step(np.zeros(3, int))


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ([0, 4, 0], "action=4: give 0 up, 1 right, 2 down or 3 left"),
        ([0, -1, 0], "action=-1: give 0 up"),
        ([0, 1], r"actions: give whole numbers of shape \(3,\), not int64 of shape \(2,\)"),
        ([0.0, 1.0, 2.0], "not float64"),
    ],
)
def test_only_the_four_actions_are_actions(actions, message):
    env = LabyrinthVectorEnv(3)
    env.reset()
    with pytest.raises(ValueError, match=message):
        env.step(np.array(actions))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"split": "none"}, "split=none: choose one of train, validation, test"),
        ({"split": "test", "labyrinths": [OPEN]}, "split=test: give a split or fixed"),
        ({"num_envs": 0}, "num_envs=0: give a whole number from 1 on"),
        ({"render_mode": "human"}, "render_mode=human: choose one of rgb_array, ansi"),
        ({"autoreset_mode": "never"}, "autoreset_mode=never: choose one of NextStep, SameStep"),
        ({"labyrinths": []}, "labyrinths: give at least one"),
        ({"labyrinths": OPEN}, "labyrinths: give a list, or labyrinth=... for one"),
        ({"labyrinths": [OPEN, None]}, "labyrinth=None: give a Labyrinth, its text, or the path"),
        ({"labyrinths": [OPEN], "labyrinth": OPEN}, "give labyrinth or labyrinths, not both"),
        ({"labyrinths": [OPEN, KEY_AND_DOOR]}, "2x2 and navigation, not 2x3 and key_and_door"),
        ({"reward": "much"}, "reward=much: choose one of"),
        ({"max_episode_steps": 0}, "max_episode_steps=0"),
        ({"size": 1}, "size=1"),
        ({"task": "sand"}, "task=sand"),
        ({"observation": "sound"}, "observation=sound"),
        ({"picture_memory": -1}, "picture_memory=-1: give a whole number from 0 on"),
    ],
)
def test_an_impossible_argument_is_refused_with_what_is_allowed(arguments, message):
    with pytest.raises(ValueError, match=message):
        LabyrinthVectorEnv(**{"num_envs": 2, **arguments})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"options": {"reset_mask": [True, False]}}, "option 'reset_mask': give a bool array"),
        ({"options": {"reset_mask": np.ones(3, bool)}}, r"of shape \(2,\)"),
        ({"options": {"reset_mask": np.zeros(2, bool)}}, "at least one entry must be True"),
        ({"options": {"labyrinth": OPEN}}, "5x5 and navigation, not 2x2 and navigation"),
        ({"options": {"task": "icy_floor"}}, "5x5 and navigation, not 5x5 and icy_floor"),
        ({"options": {"colour": 1}}, "option 'colour': choose among"),
        ({"seed": [1, 2, 3]}, "seed: give one, or 2 of them, not 3"),
        ({"seed": [1, -2]}, "seed=-2: give a whole number from 0 on"),
        ({"seed": "ab"}, "seed='a': give a whole number from 0 on"),
    ],
)
def test_an_impossible_reset_is_refused_with_what_is_allowed(arguments, message):
    with pytest.raises(ValueError, match=message):
        LabyrinthVectorEnv(2).reset(**arguments)


def test_an_option_that_one_labyrinth_cannot_hold_changes_none_of_them():
    closed = OPEN.replace("| S     |", "| S |   |").replace("|   +   |", "|   + - |")
    env = LabyrinthVectorEnv(2, labyrinths=[OPEN, closed], observation="vector")
    before, _ = env.reset()
    with pytest.raises(ValueError, match="this labyrinth cannot hold it"):
        env.reset(options={"start": (0, 1)})
    after, *_ = env.step(np.array([2, 2]))  # Into the outer wall.
    assert (after == before).all()


@pytest.mark.parametrize("count", [2, 128])
def test_seeds_and_generators_are_those_of_single_environments(count):
    arguments = {"size": 3, "observation": "state", "max_episode_steps": 2}
    envs = [
        gymnasium.make_vec(NAME, count, vectorization_mode=mode, vector_kwargs=same, **arguments)
        for mode, same in (("vector_entry_point", {}), ("sync", {}))
    ]
    both(envs, lambda env: env.reset(seed=42))
    assert both(envs, lambda env: env.np_random_seed) == tuple(range(42, 42 + count))
    both(envs, lambda env: [each.random() for each in env.np_random])
    for _ in range(4):
        both(envs, lambda env: env.step(np.zeros(count, int))[0])
    both(envs, lambda env: [each.random() for each in env.np_random])
    both(envs, lambda env: env.reset(seed=[None] * (count - 1) + [7])[0])
    assert both(envs, lambda env: env.np_random_seed)[-2:] == (40 + count, 7)


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("kind", ["rgb_array_list", "ansi_list"])
def test_lists_of_frames_are_those_of_single_environments(mode, kind):
    arguments = {"labyrinth": OPEN, "observation": "state", "render_mode": kind}
    ours = gymnasium.make_vec(NAME, 2, autoreset_mode=mode, **arguments)
    single = [lambda: gymnasium.make(NAME, **arguments)] * 2
    envs = ours, SyncVectorEnv(single, autoreset_mode=mode)
    both(envs, lambda env: env.reset(seed=0))
    assert ours.render_mode == kind
    for step, action in enumerate([(0, 2), (1, 3), (0, 0), (2, 1)]):
        over = both(envs, lambda env, action=action: env.step(np.array(action)))[2]
        if step in (0, 2):
            both(envs, lambda env: tuple(map(tuple, env.render())))
        if mode is AutoresetMode.DISABLED and over.any():
            both(envs, lambda env, over=over: env.reset(options={"reset_mask": over.copy()}))
    assert len(both(envs, lambda env: tuple(map(tuple, env.render())))[1]) == 1


def test_vector_environments_are_made_again_from_the_json_of_their_specification():
    labyrinths = [parse(OPEN), CLOSER, parse(CLOSER)]
    for arguments in (
        {"num_envs": np.int64(2), "labyrinths": labyrinths, "max_episode_steps": np.int64(9)},
        {"num_envs": 2, "size": 3, "split": "test"},
        {"num_envs": 2, "labyrinth": parse(OPEN), "autoreset_mode": AutoresetMode.SAME_STEP},
        {"num_envs": 3, "size": np.int64(3), "image_size": np.int64(16), "task": Task.ICY_FLOOR},
    ):
        env = gymnasium.make_vec(NAME, **arguments)
        again = gymnasium.make_vec(EnvSpec.from_json(env.spec.to_json()))
        assert_same(env.reset(seed=4), again.reset(seed=4))
        assert env.spec.max_episode_steps == again.spec.max_episode_steps
        assert env.autoreset_mode is again.autoreset_mode


def test_numbers_of_numpys_are_as_good_as_pythons():
    numpys = LabyrinthVectorEnv(np.int64(2), image_size=np.int8(16), picture_memory=np.int64(9999))
    plain = LabyrinthVectorEnv(2, image_size=16)
    assert_same(plain.reset(seed=3), numpys.reset(seed=np.int64(3)))
    assert_same(plain.reset(seed=[3, 7]), numpys.reset(seed=np.array([3, 7])))
