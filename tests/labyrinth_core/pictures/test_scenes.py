"""Pictures of many states at once: those that the renderer draws one by one, to the last bit."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support.strategies import labyrinths

from labyrinth_core.pictures import DEFAULT_STYLE, ObservationSpec, Painter
from labyrinth_core.pictures.backdrops import Backdrops, bands_of
from labyrinth_core.pictures.resize import area_average
from labyrinth_core.pictures.scenes import KeptScenes
from labyrinth_core.world import (
    Labyrinth,
    Labyrinths,
    Look,
    State,
    Structure,
    Task,
    sample_labyrinth,
)

looks = st.sampled_from(Look)
DRAW = Backdrops.draw
image_sizes = st.integers(1, 130) | st.sampled_from([224, 299, 401, 600])


@st.composite
def views(draw_from: st.DrawFn, *tasks: Task) -> list[tuple[Labyrinth, State]]:
    """Some states of a labyrinth, in any order, with repetitions."""
    labyrinth = replace(draw_from(labyrinths(*tasks)), look=draw_from(looks))
    numbers = st.lists(st.integers(0, labyrinth.state_count - 1), min_size=1, max_size=4)
    return [(labyrinth, labyrinth.state_at(number)) for number in draw_from(numbers)]


def assert_plain(pictures: np.ndarray, drawn: list[tuple[Labyrinth, State]]) -> None:
    image_size = pictures.shape[1]
    assert (pictures.shape, pictures.dtype) == ((len(drawn), image_size, image_size, 3), np.uint8)
    for picture, (labyrinth, state) in zip(pictures, drawn, strict=True):
        plain = area_average(Painter(labyrinth).array(state), image_size)
        np.testing.assert_array_equal(picture, plain, repr((labyrinth, state)))


def draw(views, image_size, resize="area"):
    """Return the pictures of states, drawn together."""
    return ObservationSpec("image", image_size, resize=resize).look(views)


@pytest.mark.slow
@given(st.lists(views(), min_size=1, max_size=2), image_sizes, st.randoms())
@settings(max_examples=30)
def test_states_drawn_together_are_those_drawn_plainly(several, image_size, random):
    drawn = [view for some in several for view in some]
    random.shuffle(drawn)
    assert_plain(draw(drawn, image_size), drawn)


@pytest.mark.slow
@pytest.mark.parametrize("task", Task)
@pytest.mark.parametrize(("height", "width", "image_size"), [(17, 30, 64), (40, 9, 31), (6, 6, 61)])
def test_cells_hardly_larger_than_a_pixel_or_smaller_are_exact(height, width, image_size, task):
    rng = np.random.default_rng(height)
    labyrinth = sample_labyrinth(height, width, task, rng)
    numbers = rng.integers(labyrinth.state_count, size=3).tolist()
    drawn = [(labyrinth, labyrinth.state_at(number)) for number in numbers]
    assert_plain(draw(drawn, image_size), drawn)


@pytest.mark.slow
@pytest.mark.parametrize("task", Task)
def test_many_pictures_are_those_of_each_labyrinth_alone(task):
    """They are drawn in several turns, since they and their sums are larger than a cache."""
    rng = np.random.default_rng(0)
    sampled = [sample_labyrinth(4, 4, task, rng) for _ in range(30)]
    each = [[(own, own.state_at(number)) for number in range(16)] for own in sampled]
    several = draw([view for views in each for view in views], 120)
    np.testing.assert_array_equal(several, np.concatenate([draw(views, 120) for views in each]))


@pytest.mark.parametrize("task", [Task.NAVIGATION, Task.KEY_AND_DOOR])
def test_kept_scenes_show_any_states_in_one_go(task, monkeypatch):
    rng = np.random.default_rng(0)
    sampled = [sample_labyrinth(4, 4, task, rng) for _ in range(5)]
    parts = []
    monkeypatch.setattr("labyrinth_core.pictures.backdrops.SUMS_BYTES", 2**17)
    monkeypatch.setattr(
        Backdrops, "draw", lambda self, *given: parts.append(self) or DRAW(self, *given)
    )
    which = rng.integers(len(sampled), size=40)
    states = rng.integers(sampled[0].state_count, size=len(which))
    seen = KeptScenes(Labyrinths.of(sampled), 30).draw(which, states)
    assert len(parts) == 1
    views = zip([sampled[each] for each in which], states.tolist(), strict=True)
    assert_plain(seen, [(labyrinth, labyrinth.state_at(state)) for labyrinth, state in views])


@pytest.mark.parametrize("task", [Task.NAVIGATION, Task.KEY_AND_DOOR])
def test_the_memory_of_kept_scenes_is_known_before_they_are_drawn(task):
    some = Labyrinths.of([sample_labyrinth(5, 5, task, np.random.default_rng(0))] * 2)
    drawn = vars(KeptScenes(some, 64)._backdrops)
    assert KeptScenes.memory_of(some, 64) == drawn["_sums"].nbytes + drawn["_colours"].nbytes


@given(labyrinths(), st.integers(1, 600), st.data())
@settings(max_examples=25)
def test_bilinear_is_what_a_tensor_is_resized_to_without_antialiasing(labyrinth, image_size, data):
    state = labyrinth.state_at(data.draw(st.integers(0, labyrinth.state_count - 1)))
    painter = Painter(labyrinth, replace(DEFAULT_STYLE, wall_pixels=2))
    large = torch.tensor(painter.array(state)).permute(2, 0, 1)[None].double()
    expected = torch.nn.functional.interpolate(
        large, (image_size, image_size), mode="bilinear", align_corners=False, antialias=False
    )[0].permute(1, 2, 0)
    view = [(labyrinth, state)]
    (small,) = draw(view, image_size, "original")
    # Rounded to whole numbers, here exactly.
    assert np.abs(small - expected.numpy()).max() <= 0.5 + 1e-6


@pytest.mark.parametrize(("size", "lost"), [(3, 1), (4, 3), (5, 3)])
def test_without_antialiasing_walls_as_thin_as_the_originals_vanish(size, lost):
    # No passage leads from one column to the next, save in the top row.
    columns = [(cell, cell + size) for cell in range(size * (size - 1))]
    top = [(cell, cell + 1) for cell in range(size * (size - 1), size * size - 1)]
    walled = Labyrinth(Structure.from_passages(size, size, columns + top), 0, size * size - 1)

    def vanished(resize):
        (picture,) = draw([(walled, walled.initial)], 64, resize)
        row = picture[64 - 64 // size - 64 // (2 * size)].mean(axis=1)  # The second from below.
        near = [slice(64 * line // size - 2, 64 * line // size + 3) for line in range(1, size)]
        return sum(row[pixels].min() == 255 for pixels in near)

    assert vanished("original") == lost
    assert vanished("area") == 0


@pytest.mark.slow
@pytest.mark.parametrize("look", [Look.PLAIN, Look.THIN_WALLS])
@pytest.mark.parametrize("most", [2, 5, 25, 74, 100, 151, 299])
def test_the_whole_agent_is_drawn_wherever_it_is_and_whatever_the_walls(most, look):
    labyrinth = replace(Labyrinth(Structure.without_walls(2, most), 0, 2 * most - 1), look=look)
    drawn = [(labyrinth, State(cell)) for cell in (0, most // 3, most - 1, most + most // 2)]
    for image_size in (1, 7, 64):
        assert_plain(draw(drawn, image_size), drawn)


@pytest.mark.parametrize("image_size", [64, 100, 61, 600])
def test_sums_just_below_the_next_colour_are_rounded_down(image_size):
    bands = bands_of(5, 5, None, image_size)
    whole = np.arange(1, 256) * bands.unit
    dtype = bands.rows.bands.dtype
    assert 256 * bands.unit < 2 ** (np.finfo(dtype).nmant + 1), "sums are exact"
    assert bands.rounded((whole - 1).astype(dtype)).tolist() == list(range(255))
    assert bands.rounded(whole.astype(dtype)).tolist() == list(range(1, 256))
