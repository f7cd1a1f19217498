"""The single environment: what it says is true, and a seed settles it."""

import pickle
import sys
import warnings
from copy import deepcopy
from importlib.util import find_spec, module_from_spec

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import DependencyNotInstalled, ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import PassiveEnvChecker, TimeAwareObservation, TimeLimit
from hypothesis import given, settings
from support.known_labyrinths import OPEN
from support.known_labyrinths import SMALL_KEY_AND_DOOR as KEY_AND_DOOR
from support.strategies import labyrinths

from labyrinth_core.env import LabyrinthEnv
from labyrinth_core.language import dump, labyrinth_id, parse
from labyrinth_core.pictures import ObservationSpec, render
from labyrinth_core.world import BUCKETS, Action, Labyrinth, Look, Solver, State, Structure, Task

NAME = "labyrinth_core.env:Labyrinth-v0"
KINDS = ["image", "vector", "state"]
UP, RIGHT, DOWN, LEFT = Action

ICY_FLOOR = """
icy_floor: True
labyrinth:
-------------
|   | I   E |
|   +   +   |
| S         |
-------------
end
"""
TEXTS = {Task.NAVIGATION: OPEN, Task.KEY_AND_DOOR: KEY_AND_DOOR, Task.ICY_FLOOR: ICY_FLOOR}


@pytest.fixture(autouse=True)
def no_screen(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def walk(env, actions):
    """Return what each of the actions gives, from a reset on."""
    env.reset()
    return [env.step(action) for action in actions]


def texts(env, count, **options):
    return [env.reset(options=options)[1]["labyrinth"] for _ in range(count)]


@pytest.mark.slow
@pytest.mark.parametrize("task", Task)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [4, "3x5"])
def test_gymnasiums_checker_finds_nothing_to_say(task, kind, size):
    env = gymnasium.make(NAME, size=size, task=task, observation=kind, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)


def test_gymnasium_make_leaves_its_checker_on():
    env = gymnasium.make(NAME)
    checked = False
    while env is not env.unwrapped:
        checked |= isinstance(env, PassiveEnvChecker)
        env = env.env
    assert checked


@pytest.mark.parametrize("task", Task)
@pytest.mark.parametrize("kind", KINDS)
def test_every_observation_lies_in_the_space_and_the_space_is_no_larger(task, kind):
    env = LabyrinthEnv(4, task, observation=kind)
    observation, _ = env.reset(seed=1)
    actions = np.random.default_rng(1).integers(4, size=300)
    seen = [observation]
    for action in actions:
        observation, _, terminated, truncated, _ = env.step(action)
        seen.append(observation)
        if terminated or truncated:
            seen.append(env.reset()[0])
    assert all(observation in env.observation_space for observation in seen)
    if kind == "vector":
        assert env.observation_space.high.max() == 48
        assert env.observation_space.low.min() == (-1 if task is Task.KEY_AND_DOOR else 0)
        assert (env.observation_space.high[5:] == 1 + len(task.rules.grounds)).all()


@pytest.mark.slow
@given(labyrinths())
@settings(max_examples=60)
def test_a_walk_is_what_dynamics_solver_renderer_and_vector_form_say(labyrinth):
    envs = [LabyrinthEnv(labyrinth=labyrinth, observation=kind) for kind in KINDS]
    state = State(labyrinth.start)
    for env in envs:
        env.reset()
    for action in np.random.default_rng(0).integers(4, size=12).tolist():
        state = labyrinth.transition(state, action)
        number = labyrinth.state_index(state)
        (image, *rest, info), (vector, *_), (index, *_) = (env.step(action) for env in envs)
        assert (image == render(labyrinth, state, 64)).all()
        assert (vector == ObservationSpec("vector").look([(labyrinth, state)])).all()
        assert index == number
        assert rest == [labyrinth.reward(state), labyrinth.is_terminal(state), False]
        assert info["labyrinth"] == dump(labyrinth)
        assert info["labyrinth_id"] == labyrinth_id(labyrinth)
        assert info["distance"] == Solver(labyrinth).distances[number]
        assert info["is_success"] is (state.agent == labyrinth.goal)
        assert (info["optimal_actions"] == Solver(labyrinth).optimal_actions()[number]).all()
        assert envs[0].state == state
        if labyrinth.is_terminal(state):
            break


@pytest.mark.parametrize("task", Task)
def test_a_seed_settles_the_labyrinth_and_all_that_follow(task):
    first, second = LabyrinthEnv(task=task), LabyrinthEnv(task=task)
    texts(second, 3)
    second.reset(options={"labyrinth": ICY_FLOOR})
    drawn = [env.reset(seed=7)[1]["labyrinth"] for env in (first, second)]
    assert drawn[0] == drawn[1]
    assert texts(first, 5) == texts(second, 5)
    assert first.reset(seed=8)[1]["labyrinth"] != drawn[0]


def test_a_seed_gives_the_labyrinth_that_it_always_gave():
    expected = {
        Task.NAVIGATION: "25d4232c5532085b",
        Task.PARTIAL_OBSERVABILITY: "22b41a3017447bf1",
        Task.KEY_AND_DOOR: "4ec0d477c44bad83",
        Task.ICY_FLOOR: "3507aa383feb3684",
    }
    for task, labyrinth in expected.items():
        assert LabyrinthEnv(task=task).reset(seed=0)[1]["labyrinth_id"] == labyrinth


def test_every_reset_draws_afresh_unless_a_labyrinth_is_kept():
    assert len(set(texts(LabyrinthEnv(), 20))) == 20
    assert len(set(texts(LabyrinthEnv(labyrinth=OPEN), 5))) == 1


@pytest.mark.parametrize("buckets", [(34, 33, 33), (10, 10, 80)])
@pytest.mark.parametrize("split", BUCKETS._fields)
def test_a_split_keeps_to_its_structures_and_to_the_seed(split, buckets):
    env, again = (LabyrinthEnv(3, split=split, buckets=buckets) for _ in range(2))
    env.reset(seed=5)
    again.reset(seed=5)
    for _ in range(60):
        assert env.labyrinth.structure.split(buckets) == split
        assert env.labyrinth == again.labyrinth
        env.reset()
        again.reset()


@pytest.mark.parametrize("options", [{"start": (0, 1)}, {"goal": (1, 1)}, {"task": "icy_floor"}])
def test_with_another_start_or_goal_no_turned_structure_is_of_another_split(options):
    env = LabyrinthEnv(4, split="train")
    env.reset(seed=5)
    for _ in range(30):
        env.reset(options=options)
        structure = env.labyrinth.structure
        images = [structure] if "task" in options else [structure, min(structure.symmetries())]
        assert {each.split(BUCKETS) for each in images} == {"train"}


def test_a_split_without_a_structure_is_refused_in_one_line():
    env = LabyrinthEnv(2, split="test", buckets=(98, 1, 1))
    with pytest.raises(ValueError, match=r"^split=test: size=2x2.* none of 10,000 .*") as refused:
        env.reset(seed=0)
    assert "\n" not in str(refused.value)


def test_a_labyrinth_comes_as_itself_as_text_or_in_a_file(tmp_path):
    path = tmp_path / "open.labyrinth"
    path.write_text(OPEN)
    for given_as in (OPEN, path, parse(OPEN)):
        env = gymnasium.make(NAME, labyrinth=given_as)
        assert env.reset()[1]["labyrinth"] == dump(parse(OPEN))
        assert env.unwrapped.labyrinth == parse(OPEN)


def test_options_change_task_start_and_goal_of_one_episode():
    env = LabyrinthEnv(5)
    options = {"task": "key_and_door", "start": (0, 4), "goal": (4, 0), "max_episode_steps": 9}
    given = options.copy()
    _, info = env.reset(seed=0, options=options)
    assert options == given
    labyrinth = parse(info["labyrinth"])
    assert (labyrinth.task, labyrinth.start, labyrinth.goal) == (Task.KEY_AND_DOOR, 4, 20)
    assert Solver(labyrinth).tiles_matter
    plain = parse(env.reset()[1]["labyrinth"])
    assert (plain.task, plain.start, plain.goal) == (Task.NAVIGATION, 0, 24)


def test_an_option_of_a_reset_keeps_the_look_of_the_labyrinth():
    labyrinth = Labyrinth(Structure.without_walls(3, 3), 0, 8, look=Look.RECOLOURED)
    env = LabyrinthEnv(labyrinth=labyrinth)
    for options in ({}, {"start": (0, 1)}, {"goal": (1, 0)}, {"task": "partial_observability"}):
        env.reset(options=options)
        assert env.labyrinth.look is Look.RECOLOURED, options


@pytest.mark.parametrize("task", TEXTS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_labyrinth_of_another_task_switches_the_task_and_the_space_with_it(task, kind):
    env = gymnasium.make(NAME, size=6, task="partial_observability", observation=kind)
    observation, _ = env.reset(options={"labyrinth": TEXTS[task]})
    assert env.unwrapped.labyrinth == parse(TEXTS[task])
    assert observation in env.observation_space
    assert env.step(RIGHT)[0] in env.observation_space
    observation, _ = env.reset()
    assert env.unwrapped.labyrinth.task is Task.PARTIAL_OBSERVABILITY
    assert observation in env.observation_space


def test_tiles_stay_where_they_are_unless_start_goal_or_task_change():
    env = LabyrinthEnv(labyrinth=KEY_AND_DOOR)
    env.reset(options={"start": (0, 0), "task": "key_and_door"})
    assert env.labyrinth == parse(KEY_AND_DOOR)
    env.reset(seed=0, options={"goal": (0, 2)})
    assert env.labyrinth.goal == 2
    assert Solver(env.labyrinth).tiles_matter
    env.reset()
    assert env.labyrinth == parse(KEY_AND_DOOR)


def test_a_limit_given_to_reset_is_that_of_one_episode():
    env = LabyrinthEnv(labyrinth=KEY_AND_DOOR, max_episode_steps=3)
    for options, steps in [({"max_episode_steps": 5}, 5), (None, 3), ({"max_episode_steps": 1}, 1)]:
        env.reset(options=options)
        assert [env.step(LEFT)[3] for _ in range(steps)] == [False] * (steps - 1) + [True]


IMPOSSIBLE = [
    ({"colour": 1}, "option 'colour': choose among labyrinth, task, start, goal"),
    ({"task": "sand"}, "task=sand: choose one of navigation, partial_observability, key_and_door"),
    ({"start": (9, 0)}, r"start=\(9, 0\): give \(row, column\), rows from 0 \(bottom\) to 4"),
    ({"goal": 7}, r"goal=7: give \(row, column\)"),
    ({"goal": (1, 2, 3)}, r"goal=\(1, 2, 3\): give \(row, column\)"),
    ({"goal": (0, 0)}, r"goal=\(0, 0\): start and goal must be two different cells"),
    ({"max_episode_steps": 0}, "max_episode_steps=0: give a whole number from 1 on"),
    ({"max_episode_steps": "5"}, "max_episode_steps='5': give a whole number from 1 on"),
    ({"labyrinth": OPEN, "goal": (0, 0)}, "start and goal must be two different cells"),
    ({"labyrinth": OPEN, "task": "icy_floor"}, "cannot hold it; no place for ice"),
    ({"labyrinth": 3}, "labyrinth=3: give a Labyrinth, its text, or the path of a file"),
    ({"labyrinth": "labyrinth: 5\n"}, "<text>:1:"),
    ({"labyrinth": "no_such.labyrinth"}, "labyrinth=no_such.labyrinth: No such file"),
]


@pytest.mark.parametrize(("options", "message"), IMPOSSIBLE)
def test_an_impossible_option_is_refused_with_what_is_allowed(options, message):
    with pytest.raises(ValueError, match=message):
        LabyrinthEnv().reset(options=options)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"size": 1}, "size=1: give a whole number from 2 to 1,000"),
        ({"size": (2, 3, 4)}, "size=2x3x4: give"),
        ({"task": "sand"}, "task=sand: choose one of navigation"),
        ({"observation": "sound"}, "observation=sound: choose one of image, vector.*, state"),
        ({"image_size": 0}, "image_size=0: give a whole number from 1 to 600"),
        ({"reward": "much"}, "reward=much: choose one of default, normalised"),
        ({"render_mode": "smell"}, "render_mode=smell: choose one of rgb_array, human, ansi"),
        ({"max_episode_steps": 0}, "max_episode_steps=0: give a whole number from 1 on"),
        ({"split": "eval"}, "split=eval: choose one of train, validation, test"),
        ({"split": "s0"}, "split=s0: choose one of train, validation, test"),
        ({"split": "train", "labyrinth": OPEN}, "split=train: give a split or fixed labyrinths"),
        *(
            ({"buckets": buckets}, "buckets=.*: give three percentages of 1 or more that add up")
            for buckets in ((50, 50), (100, 0, 0), (50, 25, 26), (50.0, 25, 25), 34, "abc", None)
        ),
    ],
)
def test_an_impossible_argument_is_refused_with_what_is_allowed(arguments, message):
    with pytest.raises(ValueError, match=message):
        LabyrinthEnv(**arguments)


def test_an_episode_can_be_cut_sooner_and_never_later():
    for make, most in [
        (lambda steps: LabyrinthEnv(2, max_episode_steps=steps), LabyrinthEnv),
        (lambda steps: gymnasium.make(NAME, size=2, max_episode_steps=steps), TimeLimit),
    ]:
        for limit, expected in [(1, 1), (7, 7), (1_000, 160)]:
            env = make(limit)
            assert isinstance(env, most)
            env.reset(seed=0)
            cut = next(step for step in range(1, 2_000) if env.step(DOWN)[3])
            assert cut == expected


@given(labyrinths())
@settings(max_examples=60)
def test_an_optimal_episode_returns_exactly_one_when_rewards_are_normalised(labyrinth):
    env = LabyrinthEnv(labyrinth=labyrinth, reward="normalised", observation="state")
    steps = walk(env, Solver(labyrinth).shortest_route(np.random.default_rng(0)))
    assert steps[-1][2]
    assert sum(paid for _, paid, *_ in steps) == pytest.approx(1.0, abs=1e-12)


def test_steps_outside_an_episode_are_refused():
    env = LabyrinthEnv(labyrinth=OPEN, render_mode="rgb_array")
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step(UP)
    with pytest.raises(ResetNeeded, match="call reset"):
        env.render()
    walk(env, [UP, RIGHT])
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step(UP)
    env.reset()
    env.step(UP)


NO_ACTIONS = (-1, 4, 2**70, 1.5, "up", "1", None, [1], np.array([1, 2]), np.array(1.0))
BOOLEANS = (True, np.True_, np.array(True), torch.tensor(True))
WITH_AXES = (np.array([1]), np.array([[1]]), torch.tensor([1]), torch.tensor([[1]]))


@pytest.mark.parametrize("action", [*NO_ACTIONS, *BOOLEANS, *WITH_AXES])
def test_only_the_four_actions_are_actions(action):
    env = LabyrinthEnv()
    env.reset()
    with pytest.raises(ValueError, match=r"action=.*: give 0 up, 1 right, 2 down or 3 left"):
        env.step(action)


@pytest.mark.parametrize(
    "action", [1, np.int64(1), np.uint8(1), np.array(1), torch.tensor(1), Action.RIGHT]
)
def test_an_action_may_come_in_any_whole_number_type(action):
    assert walk(LabyrinthEnv(labyrinth=OPEN, observation="state"), [action])[0][0] == 1


def test_the_picture_is_that_of_the_dataset():
    env = LabyrinthEnv(labyrinth=KEY_AND_DOOR, render_mode="rgb_array", observation="state")
    walk(env, [UP])
    assert (env.render() == render(parse(KEY_AND_DOOR), State(3, True))).all()
    assert env.render().shape == (600, 600, 3)
    env = LabyrinthEnv(labyrinth=OPEN)
    env.reset()
    assert env.render() is None


def test_the_drawing_shows_the_agent_and_what_is_left():
    env = LabyrinthEnv(labyrinth=KEY_AND_DOOR, render_mode="ansi")
    env.reset()
    drawn = [env.render()]
    for action in (UP, DOWN, RIGHT, UP, DOWN):
        env.step(action)
        drawn.append(env.render())
    assert drawn[0].splitlines()[1:4] == ["| K | D   E |", "|   +   + - |", "| @         |"]
    assert drawn[1].splitlines()[1:4] == ["| @ | D   E |", "|   +   + - |", "| S         |"]
    assert drawn[5].splitlines()[1:4] == ["|   |     E |", "|   +   + - |", "| S   @     |"]


def test_a_window_shows_each_step_and_closes():
    import pygame

    env = LabyrinthEnv(labyrinth=OPEN, render_mode="human")
    env.metadata = {**env.metadata, "render_fps": 1_000}
    env.reset()
    env.step(UP)
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)
    assert (shown == render(parse(OPEN), State(2))).all()
    assert env.render() is None
    env.close()
    assert not pygame.display.get_init()
    env.close()


def test_a_window_without_pygame_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    monkeypatch.delitem(sys.modules, "labyrinth_core.env.window", raising=False)
    with pytest.raises(DependencyNotInstalled, match=r"pip install 'labyrinth-datasets\[play\]'"):
        LabyrinthEnv(render_mode="human").reset()


def test_where_pygame_is_not_installed_no_window_is_promised(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    spec = find_spec("labyrinth_core.env.environment")
    environment = module_from_spec(spec)
    spec.loader.exec_module(environment)
    assert environment.LabyrinthEnv.metadata["render_modes"] == ["rgb_array", "ansi"]


@pytest.mark.parametrize("leave", ["q", "escape", "close"])
def test_a_person_plays_with_the_arrow_keys(leave):
    import pygame

    from labyrinth_core.env.play import play

    env = LabyrinthEnv(labyrinth=OPEN)
    walked = []
    env.step, step = lambda action: (walked.append(action), step(action))[1], env.step
    env.window()
    pygame.display.set_mode((9, 9))
    # The goal is reached by the second key; the third has no effect before R.
    keys = [pygame.K_UP, pygame.K_RIGHT, pygame.K_LEFT, pygame.K_r, pygame.K_RIGHT, pygame.K_x]
    for key in keys + {"q": [pygame.K_q], "escape": [pygame.K_ESCAPE]}.get(leave, []):
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    play(env)
    assert walked == [UP, RIGHT, RIGHT]
    assert env.state == State(1)
    assert not pygame.display.get_init()


@pytest.mark.parametrize("kind", ["image", "vector", "state"])
def test_an_environment_can_be_pickled_in_the_middle_of_an_episode(kind):
    env = LabyrinthEnv(size=4, observation=kind)
    env.reset(seed=0)
    env.step(0)
    again = pickle.loads(pickle.dumps(env))
    for action in (1, 2, 3, 0):
        (observation, *others, info), (seen, *same, told) = env.step(action), again.step(action)
        assert np.array_equal(observation, seen)
        assert (others, info["distance"]) == (same, told["distance"])


def test_numbers_of_numpys_are_as_good_as_pythons():
    number = np.int64
    numpys = LabyrinthEnv(
        (number(3), number(4)), image_size=number(32), max_episode_steps=number(7)
    )
    plain = LabyrinthEnv("3x4", image_size=32, max_episode_steps=7)
    options = {"start": (1, 0), "goal": (2, 3), "max_episode_steps": 2}
    given = {"start": np.array([1, 0]), "goal": (number(2), 3), "max_episode_steps": number(2)}
    ours, theirs = plain.reset(seed=5, options=options), numpys.reset(seed=number(5), options=given)
    assert (ours[0] == theirs[0]).all()
    assert ours[1]["labyrinth"] == theirs[1]["labyrinth"]
    assert [numpys.step(LEFT)[3] for _ in range(2)] == [False, True]


@pytest.mark.parametrize("seed", [True, 1.0, -1, "1"])
def test_a_seed_that_is_no_whole_number_is_refused(seed):
    with pytest.raises(ValueError, match=f"^seed={seed!r}: give a whole number from 0 on$"):
        LabyrinthEnv().reset(seed=seed)


def test_an_environment_is_made_again_from_the_json_of_its_specification(tmp_path):
    path = tmp_path / "open.labyrinth"
    path.write_text(OPEN)
    for arguments in (
        {"labyrinth": parse(OPEN)},
        {"labyrinths": [parse(OPEN), path]},
        {"labyrinth": path},
        {"labyrinth": str(path), "task": Task.NAVIGATION},
        {"size": np.int64(3), "image_size": np.int32(16), "task": Task.KEY_AND_DOOR},
        {"size": (np.int64(3), 4), "observation": "vector", "reward": "normalised"},
        {"size": 3, "split": "train", "buckets": (80, np.int64(10), 10)},
    ):
        env = gymnasium.make(NAME, **arguments)
        again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
        path.rename(tmp_path / "gone")
        ours, theirs = env.reset(seed=4), again.reset(seed=4)
        (tmp_path / "gone").rename(path)
        assert (ours[0] == theirs[0]).all()
        assert ours[1]["labyrinth"] == theirs[1]["labyrinth"]
        assert env.spec.max_episode_steps == again.spec.max_episode_steps


def test_the_specification_says_when_an_episode_is_cut_so_that_time_can_be_observed():
    env = gymnasium.make(NAME, size="3x4", observation="vector")
    assert env.spec.max_episode_steps == 480
    timed = TimeAwareObservation(env, flatten=False)
    assert timed.observation_space["time"].high == 480
    timed.reset(seed=0)
    assert timed.step(DOWN)[0]["time"] == 1
    assert gymnasium.make(NAME, max_episode_steps=9).spec.max_episode_steps == 9


def test_a_copy_goes_on_from_the_same_state_and_shows_no_window():
    import pygame

    env = gymnasium.make(NAME, labyrinth=OPEN, render_mode="human")
    env.unwrapped.metadata = {**env.metadata, "render_fps": 1_000}
    env.reset()
    env.step(UP)
    twin = deepcopy(env)
    twin.step(DOWN)
    assert twin.render() is None
    assert (env.unwrapped.state, twin.unwrapped.state) == (State(2), State(0))
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)
    assert (shown == render(parse(OPEN), State(2))).all()
    twin.close()
    env.step(DOWN)
    assert pygame.display.get_init()
    env.close()
