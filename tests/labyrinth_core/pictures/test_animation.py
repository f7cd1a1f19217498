import io

import numpy as np
import pytest
from PIL import Image

from labyrinth_core.pictures.animation import beside, frames_of, gif
from labyrinth_core.world import Solver, Task, sample_labyrinth


def episode(task, size=5):
    rng = np.random.default_rng(3)
    labyrinth = sample_labyrinth(size, size, task, rng)
    return labyrinth.replay(Solver(labyrinth).shortest_route(rng))


def decoded(data):
    """Return the frames of a GIF file and how long each is shown, in milliseconds."""
    with Image.open(io.BytesIO(data)) as picture:
        frames, durations = [], []
        for at in range(picture.n_frames):
            picture.seek(at)
            frames.append(np.array(picture.convert("RGB")))
            durations.append(picture.info["duration"])
        assert picture.info["loop"] == 0
    return np.stack(frames), durations


def test_a_gif_holds_the_pictures_of_every_state_of_one_episode_after_another_to_the_pixel():
    episodes = [frames_of(episode(task)) for task in Task]
    shown, durations = decoded(gif(episodes))
    assert np.array_equal(shown, np.concatenate(episodes))
    assert durations == [ms for each in episodes for ms in [300] * (len(each) - 1) + [1500]]


def test_the_shorter_of_two_episodes_waits_for_the_other():
    short, long = frames_of(episode(Task.NAVIGATION, 3)), frames_of(episode(Task.NAVIGATION))
    both = beside(short, long, gap=4)
    assert len(both) == len(long)
    assert both[0].shape == (300, 604, 3)
    assert np.array_equal(both[-1][:, :300], short[-1])
    assert np.array_equal(both[-1][:, 304:], long[-1])


@pytest.mark.parametrize(
    ("episodes", "found"),
    [
        ([], "no frames"),
        (np.zeros((2, 9, 9, 3), np.uint8), r"\(9, 3\)"),
        ([np.zeros((1, size, size, 3), np.uint8) for size in (9, 8)], r"\(8, 8, 3\), \(9, 9, 3\)"),
    ],
)
def test_frames_of_other_shapes_are_refused(episodes, found):
    with pytest.raises(ValueError, match=rf"^{found}: give episodes, each a list of frames"):
        gif(episodes)
