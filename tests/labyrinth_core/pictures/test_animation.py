import io

import numpy as np
from PIL import Image

from labyrinth_core.pictures import Painter, animate
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


def pictures_of(shown):
    """Return the pictures of an episode's states, shape (T + 1, 300, 300, 3)."""
    painter = Painter(shown.labyrinth)
    return np.stack([painter.array(state, 300) for state in shown.states])


def test_a_gif_holds_the_pictures_of_every_state_to_the_pixel():
    for task in Task:
        pictures = pictures_of(episode(task))
        shown, durations = decoded(animate(episode(task)))
        assert np.array_equal(shown, pictures)
        assert durations == [300] * (len(pictures) - 1) + [1500]


def test_the_shorter_of_two_episodes_waits_for_the_other():
    short, long = episode(Task.NAVIGATION, 3), episode(Task.NAVIGATION)
    shown, durations = decoded(animate(short, long))
    assert len(shown) == len(durations) == len(long) + 1
    assert shown[0].shape == (300, 620, 3)
    assert np.array_equal(shown[: len(short) + 1, :, :300], pictures_of(short))
    assert (shown[len(short) :, :, :300] == shown[len(short), :, :300]).all()
    assert (shown[:, :, 300:320] == 255).all()
    assert np.array_equal(shown[:, :, 320:], pictures_of(long))
