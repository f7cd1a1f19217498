"""A policy that remembers pictures: what it is shown is what was seen, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labyrinths_of_datasets import CONFIGS
from policies import Table, mistaken

from labyrinth_core.evaluation.answers import Player, PolicyError
from labyrinth_core.evaluation.evaluate import evaluate
from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
from labyrinth_core.evaluation.playing import step_through
from labyrinth_core.language.text import parse
from labyrinth_core.pictures.scenes import draw
from labyrinth_core.policies.remembering import PictureMemory, Remembering
from labyrinth_core.world.dynamics import initial, is_terminal, transition
from labyrinth_core.world.labyrinth import Task
from labyrinth_core.world.random_labyrinth import sample_labyrinth

CORNER = """
occlusion: True
labyrinth:
-------------
|       | E |
|   +   +   |
|   |       |
|   +   +   |
| S |       |
-------------
end
"""

HOPED = CORNER.replace("occlusion: True\n", "").replace("|       | E |", "|         E |")
"""The same, as far as it is seen from the start: the first column, and no further."""


def walk(labyrinth, actions):
    """Return the states of an episode, which ends where it is over."""
    states = [initial(labyrinth)]
    for action in actions:
        if not is_terminal(labyrinth, states[-1]):
            states.append(transition(labyrinth, states[-1], action))
    return states


@pytest.mark.slow
@given(
    st.sampled_from([(5, 5, 64), (3, 3, 64), (4, 5, 64), (2, 4, 64), (7, 7, 96), (10, 10, 128)]),
    st.integers(0, 2**32 - 1),
    st.integers(1, 30),
)
@settings(max_examples=30)
def test_what_is_remembered_is_the_picture_drawn_with_all_that_was_seen(shape, seed, steps):
    height, width, image_size = shape
    rng = np.random.default_rng(seed)
    labyrinths = [sample_labyrinth(height, width, Task.PARTIAL_OBSERVABILITY, rng) for _ in "ab"]
    memory = PictureMemory(height, width, image_size)
    walks = [walk(each, rng.integers(4, size=steps).tolist()) for each in labyrinths]
    for _ in range(2):  # Nothing is left of other episodes.
        memory.reset(2)
        for step in range(steps):
            now = [states[min(step, len(states) - 1)] for states in walks]
            pictures = draw(list(zip(labyrinths, now, strict=True)), image_size)
            seen = [frozenset(state.agent for state in states[: step + 1]) for states in walks]
            drawn = draw(list(zip(labyrinths, now, strict=True)), image_size, seen_from=seen)
            fresh = PictureMemory(height, width, image_size)
            fresh.reset(2)
            shown = memory.add(pictures)
            np.testing.assert_array_equal(shown, fresh.add(drawn))
            assert (shown >= drawn).all()  # White floor is shown where all is black.


def test_what_has_not_been_seen_is_shown_as_floor_and_what_has_been_is_as_it_is():
    labyrinth, hoped = parse(CORNER), parse(HOPED)
    memory = PictureMemory(3, 3, 600)
    memory.reset(1)
    (shown,) = memory.add(draw([(labyrinth, initial(labyrinth))], 600))
    np.testing.assert_array_equal(shown, draw([(hoped, initial(hoped))], 600)[0])


def test_the_policy_is_asked_once_about_a_picture_of_an_episode():
    asked = []

    def policy(pictures):
        asked.append(len(pictures))
        return np.zeros(len(pictures), np.int64)

    labyrinth = sample_labyrinth(3, 3, Task.PARTIAL_OBSERVABILITY, np.random.default_rng(0))
    states = walk(labyrinth, [0, 1])
    memory = Remembering(policy, PictureMemory(3, 3))
    for _ in range(2):
        memory.reset(2)
        for state in (states[0], states[0], states[-1]):
            memory.act(draw([(labyrinth, state), (labyrinth, states[0])], 64))
    assert states[0] != states[-1]
    assert asked == [1, 1] * 2


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.2, 0.6, 1.0])
def test_an_episode_that_goes_round_ends_as_after_all_its_steps(datasets, share):
    arrays = load_arrays(datasets, "3x4-partial_observability", "train")
    policy = Table(arrays, mistaken(arrays, share, 1))
    saying = Remembering(policy, PictureMemory(3, 4))
    taken = []

    class Silent:
        def reset(self, count):
            saying.reset(count)

        def act(self, pictures):
            taken.append(1)
            return saying.act(pictures)

    whole = step_through(Player.of(Silent(), 0), arrays, 1)
    silent, taken[:] = len(taken), []
    act, saying.act = saying.act, lambda pictures: taken.append(1) or act(pictures)
    short = step_through(Player.of(saying, 0), arrays, 1)
    np.testing.assert_array_equal(short.outcomes, whole.outcomes)
    np.testing.assert_array_equal(short.moves, whole.moves)
    assert not whole.solved.all()
    assert len(taken) < silent == arrays.step_limit


@pytest.mark.parametrize(("side", "image_size"), [(6, 64), (5, 40), (10, 64)])
def test_pictures_in_which_walls_are_thinner_than_a_pixel_are_refused(side, image_size):
    words = f"pictures of {image_size} pixels are too small to remember {side}x{side} labyrinths"
    with pytest.raises(ValueError, match=words):
        PictureMemory(side, side, image_size)


def test_the_memory_is_made_anew_for_labyrinths_of_another_size(datasets):
    config = CONFIGS[Task.PARTIAL_OBSERVABILITY]
    shown = []

    def up(pictures):
        shown.append(pictures.copy())
        return np.zeros(len(pictures), np.int64)

    for size in ((3, 4), (5, 5)):
        evaluate(Remembering(up, PictureMemory(*size)), datasets, config, splits=["test"])
    half = len(shown) // 2
    assert all(map(np.array_equal, shown[:half], shown[half:]))


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"observation": "vector"}, "looks at observation=vector, and is shown image"),
        ({"image_size": 600}, "image_size=600 at 3x4, and is shown image_size=64"),
        ({"resize": "original"}, "the memory cannot show pictures of resize=original"),
    ],
)
def test_a_policy_that_cannot_be_shown_the_memory_is_refused(datasets, stated, message):
    def up(pictures):
        return np.zeros(len(pictures), np.int64)

    vars(up).update(stated)
    with pytest.raises(PolicyError, match=message):
        evaluate(
            Remembering(up, PictureMemory(3, 4)), datasets, CONFIGS[Task.PARTIAL_OBSERVABILITY]
        )
