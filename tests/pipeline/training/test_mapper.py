"""The mapper learns what moves, what actions do and where to go, whatever the colours."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from support.learning import learner_of, method_of, settings_of
from support.making import Run, perform

from labyrinth_core import load_policy
from labyrinth_core.evaluation import LabyrinthArrays, Player, PolicyError
from labyrinth_core.learning import NetworkSpec, Problem, Steps
from labyrinth_core.learning.networks.slots import Slots, masks_of
from labyrinth_core.pictures import PICTURE_SIZE, ObservationSpec, render
from labyrinth_core.pictures.style import Style
from labyrinth_core.policies import RunRecord
from labyrinth_core.world import Labyrinth, Solver, State, Task, sample_labyrinth
from pipeline.training import train

pytestmark = pytest.mark.slow

Problems = Callable[..., Problem]

TOY: dict[str, Any] = {"epochs": 100, "batch_size": 4}


def toy(problem: Problem, **settings: Any) -> Any:
    return learner_of("mapper", problem, **TOY | settings)


@pytest.fixture(scope="module")
def folder(
    small_dataset: Run, make_run: Callable[..., Run], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The folder of a run of the stages `train` and `evaluate`."""
    run = make_run(
        small_dataset.data_dir,
        stages=["train", "evaluate"],
        run_dir=str(tmp_path_factory.mktemp("runs")),
        device="cpu",
        method={"name": "mapper", **TOY},
    )
    train.run(run)
    perform("evaluate", run)
    return run.training_folder


@pytest.fixture(scope="module")
def trained(folder: Path) -> Any:
    """The policy of the run, for labyrinths of 3x3."""
    return load_policy(folder)


def fresh(height: int, width: int, **settings: Any) -> Any:
    """Return the policy of a mapper with fresh weights."""
    spec = NetworkSpec("mapper", height, width, "navigation")
    mapper, chosen = method_of("mapper"), settings_of("mapper", **settings)
    weights = mapper.make(spec, chosen).state_dict()
    return mapper.player(mapper.trained(weights, spec, chosen), spec, chosen)


def forgetful(policy: Any) -> Any:
    """Return a mapper's policy that plans anew for each picture."""
    policy = copy(policy)
    policy.remember = False
    policy.reset(0)
    return policy


def labyrinths_of(height: int, width: int, count: int = 10) -> list[Labyrinth]:
    """Return labyrinths with any start and goal, of other structures than those of train."""
    rng = np.random.default_rng(2**20)
    ends = [rng.choice(height * width, 2, replace=False).tolist() for _ in range(count)]
    return [
        sample_labyrinth(height, width, Task.NAVIGATION, rng, start=start, goal=goal)
        for start, goal in ends
    ]


class Drawing:
    """Draws states of labyrinths in a style."""

    of_arrays = False

    def __init__(self, style: Style | None) -> None:
        self.style = style

    def look(self, views: list[tuple[Labyrinth, State]]) -> NDArray[np.uint8]:
        return np.stack([render(labyrinth, state, style=self.style) for labyrinth, state in views])


def solved(policy: Any, labyrinths: list[Labyrinth], style: Style | None = None) -> float:
    """Return the share of labyrinths that a policy solves by a shortest route."""
    drawing: Any = Drawing(style)
    won = [
        each.states[-1].agent == each.labyrinth.goal
        and len(each.actions)
        == len(Solver(each.labyrinth).shortest_route(np.random.default_rng(0)))
        for each in Player.of(policy).attempts(
            LabyrinthArrays.of_labyrinths(labyrinths, drawing), range(len(labyrinths))
        )
    ]
    return float(np.mean(won))


LOOKS = {
    "as trained": None,
    "recoloured": Style(
        (250, 240, 215),
        (70, 40, 90),
        start=(204, 121, 167),
        goal=(86, 180, 233),
        agent=(230, 159, 0),
    ),
    "thin": Style(wall_pixels=2),
    "dark": Style(floor=(0, 0, 0), wall=(0, 0, 1), agent=(1, 0, 0), goal=(255, 255, 255)),
}


SIZES = ((3, 3), (4, 6), (7, 7))
# Eight labyrinths are too few to learn thin walls from for larger ones.
CASES = [(size, look) for size in SIZES for look in LOOKS if look != "thin" or size == (3, 3)]


@pytest.mark.parametrize(("size", "look"), CASES)
def test_it_solves_labyrinths_of_any_size_start_goal_and_look(
    trained: Any, size: tuple[int, int], look: str
) -> None:
    policy = trained.for_labyrinths(*size, Task.NAVIGATION)
    assert solved(policy, labyrinths_of(*size), LOOKS[look]) >= 0.9


def test_without_bumps_it_does_not_know_that_walls_block(problem_of: Problems) -> None:
    learner = toy(problem_of(), explore=False)
    for _ in range(20):
        learner.epoch()
    policy = learner.player(learner.acting, learner.problem.spec, learner.settings)
    assert solved(policy, labyrinths_of(3, 3, 20)) < 0.8


def test_without_memory_it_confuses_the_start_with_the_goal(trained: Any) -> None:
    labyrinths = labyrinths_of(4, 4, 20)
    policy = trained.for_labyrinths(4, 4, Task.NAVIGATION)
    rates = [solved(each, labyrinths) for each in (policy, forgetful(policy))]
    assert rates[0] >= 0.9 > 0.7 > rates[1]


def test_the_same_palette_or_another_gives_the_same_actions_to_the_bit() -> None:
    torch.manual_seed(0)
    policy, rng = fresh(4, 5), np.random.default_rng(0)
    labyrinths = labyrinths_of(4, 5)
    colours = rng.permutation(256)[:27].reshape(9, 3).tolist()
    drawings = [Drawing(None), Drawing(Style(*map(tuple, colours)))]
    policies = [copy(policy) for _ in drawings]
    for policy in policies:
        policy.reset(len(labyrinths))
    for cells in [[each.start for each in labyrinths], *rng.integers(20, size=(3, 10)).tolist()]:
        views = [(each, State(cell)) for each, cell in zip(labyrinths, cells, strict=True)]
        actions = [
            policy.act(drawing.look(views))
            for policy, drawing in zip(policies, drawings, strict=True)
        ]
        assert np.array_equal(*actions)


def test_what_a_slot_is_does_not_depend_on_where_it_is() -> None:
    torch.manual_seed(0)
    network = fresh(5, 5).network
    (labyrinth,) = labyrinths_of(5, 5, 1)
    masks = masks_of(Slots.of(render(labyrinth, State(labyrinth.start))).scene(5, 5)[None])
    roles = network.roles(masks)
    assert roles.ends.std() > 1e-4
    cell = masks.shape[2] // 5
    for other in (
        torch.roll(masks, (2 * cell, 3 * cell), (2, 3)),
        masks.flip(2),
        masks.transpose(2, 3),
        torch.nn.functional.pad(masks, (0, 3 * cell, 2 * cell, 0)),
    ):
        for one, same in zip(roles, network.roles(other), strict=True):
            assert torch.allclose(one, same, atol=1e-5)


def test_a_way_is_as_passable_as_the_least_passable_line_across_it() -> None:
    torch.manual_seed(0)
    network = fresh(5, 5, channels=8).network
    seen = torch.randn(1, 2, 8, 4, 12, 12)  # A cell is 12 blocks high and wide.
    lines = [seen[..., line, None, :].expand_as(seen) for line in range(12)]
    least = torch.stack([network.passable(each) for each in lines]).amin(0)
    assert torch.allclose(network.passable(seen), least, atol=1e-6)


def test_with_permuted_actions_the_same_is_learnt_of_the_permuted_ones(
    problem_of: Problems,
) -> None:
    names = torch.tensor([2, 0, 3, 1])

    def renamed(steps: Steps) -> Steps:
        return steps._replace(actions=names.numpy()[steps.actions])

    problem = problem_of()
    usual = toy(problem)
    problem = problem_of()
    permuted = toy(
        replace(
            problem,
            demonstrations=renamed(problem.demonstrations),
            exploration=lambda: renamed(problem.exploration()),
        )
    )
    for learner in (usual, permuted):
        for _ in range(2):
            learner.epoch()
    weights, others = (dict(learner.policy.named_parameters()) for learner in (usual, permuted))
    effects, other_effects = weights.pop("effects"), others.pop("effects")
    assert torch.equal(effects, other_effects[names])
    assert not torch.equal(effects, other_effects)
    assert all(torch.equal(each, others[name]) for name, each in weights.items())


def test_it_remembers_its_plan_until_it_is_reset(trained: Any) -> None:
    labyrinth, other = labyrinths_of(3, 3, 2)
    policy = trained
    first, unlike = (render(each, State(each.start))[None] for each in (labyrinth, other))
    later = render(replace(labyrinth, goal=other.goal), State(labyrinth.start))[None]
    alone = []
    for picture in (first, unlike, later):
        policy.reset(1)
        alone.append(int(policy.act(picture)[0]))
    policy.reset(1)
    assert [int(policy.act(each)[0]) for each in (first, later)] == [alone[0]] * 2


def counted(player: Player) -> tuple[Player, list[int]]:
    """Return a player, and how many pictures it was shown each time that it was asked."""
    asked: list[int] = []

    act_in: Any = player.act

    def act(pictures: Any, episodes: Any = None) -> Any:
        asked.append(len(pictures))
        return act_in(pictures, episodes=episodes)

    return replace(player, act=act), asked


def test_what_it_says_to_remember_ends_failures_early_and_alike() -> None:
    torch.manual_seed(0)
    arrays = LabyrinthArrays.of_labyrinths(
        labyrinths_of(2, 2, 3), ObservationSpec("image", PICTURE_SIZE, draw=True)
    )
    policy = fresh(2, 2, channels=4, looks=2)
    for each in (policy, forgetful(policy)):
        player = Player.of(each, 0)
        saying, asked = counted(player)
        silent, asked_of_silent = counted(replace(player, remembered=None))
        early, late = (player.step_through(arrays, 1) for player in (saying, silent))
        assert len(asked) < len(asked_of_silent) == arrays.step_limit
        assert not early.solved.all()
        assert early.letters == late.letters
        assert np.array_equal(early.moves, late.moves)


def test_both_stages_run_it_in_pictures_of_flat_colours(folder: Path) -> None:
    losses = [row["loss"] for row in json.loads((folder / RunRecord.FILE).read_bytes())["history"]]
    assert np.mean(losses[-3:]) < np.mean(losses[:3]) / 10
    content = json.loads((folder / "results.json").read_bytes())
    assert content["splits"]["test"]["sr"] >= 0.75
    assert content["splits"]["s0_and_g"]["sr"] >= 0.75


@pytest.mark.parametrize("task", [task for task in Task if task is not Task.NAVIGATION])
def test_other_tasks_are_refused(task: Task) -> None:
    spec = NetworkSpec("mapper", 3, 3, str(task))
    with pytest.raises(PolicyError, match=f"^task={task}: method=mapper supports only"):
        method_of("mapper").make(spec, settings_of("mapper"))
