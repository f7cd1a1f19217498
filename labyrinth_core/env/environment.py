"""`LabyrinthEnv`: the labyrinth as a Gymnasium environment, and what its agent observes.

    gymnasium.make("labyrinth_core.env:Labyrinth-v0", size=5, task="key_and_door")

`vector_env` steps many labyrinths at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from importlib.util import find_spec
from operator import index
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import DependencyNotInstalled, ResetNeeded
from gymnasium.spaces import Box, Discrete, Space
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.env.labyrinth_source import (
    LabyrinthLike,
    Shape,
    Size,
    chosen,
    sources_of,
    step_limit,
    write_plainly,
)
from labyrinth_core.language import draw_text, dump, labyrinth_id
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE, OBSERVATIONS, ObservationSpec, render
from labyrinth_core.world import BUCKETS, Labyrinth, State, Tables, Task

if TYPE_CHECKING:
    from labyrinth_core.env.window import Window

Kind = str
"""One of `PLAYED`."""
PLAYED = (*(name for name in OBSERVATIONS if ObservationSpec(name).is_bounded), "state")
"""The observations of environments; `state` is the index of the state."""
Array = NDArray[np.uint8] | NDArray[np.int32]
Observation = Array | np.int64
CACHE_BYTES = 16 * 1024 * 1024
"""The memory of an observer's cache of pictures and vectors."""
TOGETHER, TOGETHER_BYTES = 32, 2**21
"""How many consecutive states are drawn together, and the most bytes of their pictures."""

REWARDS = ("default", "normalised")
RENDER_MODES = ("rgb_array", "human", "ansi")
SHOWN_HERE = [mode for mode in RENDER_MODES if mode != "human" or find_spec("pygame")]
"""The modes available here, as a window needs pygame; Gymnasium's checker tries each of them."""


class Observer:
    """Turns states into observations of one kind, each a new array.

    Raises:
        ValueError: The kind or the image size is not allowed.
    """

    def __init__(self, kind: Kind, image_size: int) -> None:
        chosen("observation", kind, PLAYED)
        self.kind = kind
        shown = "image" if kind == "state" else kind
        self._spec = ObservationSpec(shown, image_size)
        self.image_size = self._spec.image_size
        self._together = 1
        if kind == "image":
            self._together = max(1, min(TOGETHER, TOGETHER_BYTES // (3 * self.image_size**2)))
        self._cached: Callable[[Labyrinth, int], Array] | None = None
        self._latest: tuple[Labyrinth | None, int, Any] = None, 0, None
        """The latest labyrinth, the index of a block of its states, and their observations."""

    def __getstate__(self) -> dict[str, Any]:
        # The cache cannot be pickled; it refills.
        return vars(self) | {"_cached": None, "_latest": (None, 0, None)}

    def space(self, height: int, width: int, task: Task) -> Space[Any]:
        """Return the observation space for labyrinths of a size and task.

        - `image`: `Box(0, 255, (image_size, image_size, 3), uint8)`, rows from the top.
        - `vector`, and the other kinds of `observations.KINDS`: `Box`, with bounds for each entry.
        - `state`: `Discrete(states)`, the index that `Labyrinth.state_index` gives a state.
        """
        if self.kind == "state":
            return Discrete(height * width * task.rules.phases)
        low, high = self._spec.bounds(height, width, task)
        return Box(low, high, dtype=low.dtype.type)

    def observe(self, labyrinth: Labyrinth, state: int) -> Observation:
        """Return the observation of the state with the given index."""
        if self.kind == "state":
            number: np.int64 = np.int64(state)
            return number
        if self._cached is None:
            size: int = self._draw(labyrinth, 0).nbytes
            self._cached = lru_cache(max(CACHE_BYTES // size, 2))(self._draw)
        block, offset = divmod(state, self._together)
        if labyrinth is not self._latest[0] or block != self._latest[1]:  # Hashing takes longer.
            self._latest = labyrinth, block, self._cached(labyrinth, block)
        observation: Array = self._latest[2][offset].copy()
        return observation

    def _draw(self, labyrinth: Labyrinth, block: int) -> Array:
        first = block * self._together
        end = min(first + self._together, labyrinth.state_count)
        drawn: Array = self.batch([(labyrinth, state) for state in range(first, end)])
        return drawn

    def batch(self, shown: Sequence[tuple[Labyrinth, int]]) -> NDArray[Any]:
        """Return the observations of N pairs of a labyrinth and a state index, as N rows."""
        if self.kind == "state":
            return np.array([number for _, number in shown])
        views = [(labyrinth, labyrinth.state_at(number)) for labyrinth, number in shown]
        return self._spec.look(views)


class LabyrinthEnv(gymnasium.Env[Observation, np.int64]):
    """An agent moves through a labyrinth from the start to the goal.

    Actions: 0 up, 1 right, 2 down, 3 left. Rewards and ends of episodes are those of `Labyrinth`.
    An episode is truncated after `40 * width * height` steps.

    Each `reset` samples a new labyrinth, unless the constructor was given one or some. All
    randomness comes from `np_random`, so a seed determines this labyrinth and the labyrinths of all
    later episodes.

    The `info` of `reset` and `step` describes the state that the agent is in now:

    - `labyrinth_id`: sixteen hexadecimal digits, the same on every machine.
    - `labyrinth`: the text from which `labyrinth_core.parse` makes the same labyrinth.
    - `optimal_actions`: which actions begin a shortest route to the goal, bool, shape (4,); all
      False at the goal, on ice, or if no route leads to the goal.
    - `distance`: the least number of moves to the goal, -1 if no route leads there.
    - `is_success`: whether the agent is on the goal, bool.

    A copy of an environment in the middle of an episode continues from there, and shows no window.
    """

    metadata: dict[str, Any] = {"render_modes": SHOWN_HERE, "render_fps": 10}  # noqa: RUF012
    _spec: EnvSpec | None = None

    def __init__(
        self,
        size: Size = 5,
        task: Task | str = Task.NAVIGATION,
        *,
        observation: Kind = "image",
        image_size: int = DEFAULT_IMAGE_SIZE,
        labyrinth: LabyrinthLike | None = None,
        labyrinths: Iterable[LabyrinthLike] | None = None,
        split: str | None = None,
        buckets: Sequence[int] = BUCKETS,
        reward: str = "default",
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Make an environment; `reset` it before the first step.

        Args:
            size: Rows and columns, as `5`, `"4x6"` or `(4, 6)`, height first.
            task: A `Task` or its name.
            observation: `image`, as `renderer.render` draws it; `vector`, as in
                `vector.vector_observation`; or `state`, the index of the state, as
                `Labyrinth.state_index` gives it, which says nothing about the walls: for tabular
                methods on one labyrinth.
            image_size: Pixels on each side of the image.
            labyrinth: A labyrinth for every episode: its text, the path of a file, or a
                `Labyrinth`. Its size and task replace `size` and `task`.
            labyrinths: The labyrinths of the episodes in turn, all of one size and task: the first,
                or number s after `reset(seed=s)`, and so on, modulo their number.
            split: `train`, `validation` or `test`: sample only structures that a dataset may have
                in this split, so that training meets no labyrinth of another split. None samples
                all structures.
            buckets: The percentages of all structures in these three splits, as in the dataset.
            reward: `default`, or `normalised`: the reward of the goal is raised so that an optimal
                episode returns exactly 1.
            max_episode_steps: A limit below `40 * width * height` steps. The argument of the same
                name of `gymnasium.make` has the same effect, by a wrapper. Neither makes episodes
                longer.
            render_mode: `rgb_array` (600 x 600 x 3), `human` (a window, updated at every step),
                or `ansi` (the drawing as text, with `@` for the agent).

        Raises:
            ValueError: An argument has a value that is not allowed.
        """
        self._sources = sources_of(size, task, labyrinth, labyrinths, split, buckets)
        self._turn = 0
        """The number of the next episode's labyrinth, if there are several."""
        self._observer = Observer(observation, image_size)
        self._normalised = chosen("reward", reward, REWARDS) == "normalised"
        self._max_episode_steps = max_episode_steps
        shape = self._sources[0].shape
        self._limit = step_limit(shape.height * shape.width, max_episode_steps)
        if render_mode is not None:
            chosen("render_mode", render_mode, RENDER_MODES)
        self.render_mode = render_mode
        self.action_space = Discrete(4)
        self._set_shape(shape)
        self._labyrinth: Labyrinth | None = None
        self._window: Window | None = None
        self._over = True

    def __getstate__(self) -> dict[str, Any]:
        # A window cannot be copied, and a copy must not draw in or close this one.
        shown = self.render_mode == "human"
        return vars(self) | {"_window": None, "render_mode": None if shown else self.render_mode}

    @property
    def spec(self) -> EnvSpec | None:
        """The specification to recreate this environment; None if not made by `gymnasium.make`."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        values = self._sources[0].plainly() | {"image_size": self._observer.image_size}
        if spec is not None and spec.kwargs.get("labyrinths") is not None:
            kept = [source.plainly()["labyrinth"] for source in self._sources]
            values |= {"labyrinth": None, "labyrinths": kept}
        self._spec = write_plainly(spec, values, self._limit)

    def _set_shape(self, shape: Shape) -> None:
        """Adapt the observation space to the shape of a labyrinth."""
        self._shape = shape
        self.observation_space = self._observer.space(*shape)

    @property
    def labyrinth(self) -> Labyrinth:
        """The labyrinth of this episode."""
        if self._labyrinth is None:
            raise ResetNeeded("there is no labyrinth yet: call reset() first")
        return self._labyrinth

    @property
    def state(self) -> State:
        """The state that the agent is in."""
        return self.labyrinth.state_at(self._state)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode, and return the first observation and its info.

        Args:
            seed: Determines this labyrinth and, without further seeds, all later ones.
            options: For this episode only: `labyrinth` (as in the constructor); `task`; `start`
                and `goal` (each `(row, column)`, row 0 at the bottom); and `max_episode_steps`,
                which replaces the constructor's limit. If task, start or goal differ from the
                labyrinth's own, the tiles of its task are placed anew. The observation space
                changes if the labyrinth has another size or task.

        Raises:
            ValueError: The seed or the value of an option is not allowed, or an option is unknown.
        """
        if seed is not None:
            seed = whole("seed", seed, 0)
        super().reset(seed=seed)
        turn = self._turn if seed is None else seed
        options = dict(options or {})
        most = options.pop("max_episode_steps", None)
        source = self._sources[turn % len(self._sources)]
        labyrinth = source.draw(self.np_random, options)
        most = self._max_episode_steps if most is None else most
        limit = step_limit(labyrinth.structure.cells, most)
        if labyrinth is not self._labyrinth:
            self._load(labyrinth)
        self._turn = turn + 1
        self._state = self._initial
        self._limit = limit
        self._steps = 0
        self._over = False
        if self.render_mode == "human":
            self._show()
        return self._observer.observe(labyrinth, self._state), self._info()

    def _load(self, labyrinth: Labyrinth) -> None:
        tables = Tables.of(labyrinth, normalised=self._normalised)
        shape = Shape.of(labyrinth)
        if shape != self._shape:
            self._set_shape(shape)
        self._labyrinth = labyrinth
        self._text = dump(labyrinth)
        self._id = labyrinth_id(self._text)
        self._initial = tables.initial
        self._optimal_actions = tables.optimal_actions
        # Lists, since reading one item of an array takes several times as long.
        self._transitions: list[list[int]] = tables.transitions.tolist()
        self._rewards: list[float] = tables.rewards.tolist()
        self._terminal: list[bool] = tables.terminal.tolist()
        self._distances: list[int] = tables.distances.tolist()

    def step(self, action: int | np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take an action, and return observation, reward, terminated, truncated and info.

        Raises:
            ResetNeeded: The episode is over, or has not begun.
            ValueError: The action is not one of the four.
        """
        if self._over:
            raise ResetNeeded("no episode is under way: call reset() before step()")
        self._state = state = self._transitions[self._state][_checked(action)]
        self._steps += 1
        terminated = self._terminal[state]
        truncated = self._steps >= self._limit
        self._over = terminated or truncated
        if self.render_mode == "human":
            self._show()
        observation = self._observer.observe(self.labyrinth, state)
        return observation, self._rewards[state], terminated, truncated, self._info()

    def _info(self) -> dict[str, Any]:
        distance = self._distances[self._state]
        return {
            "labyrinth_id": self._id,
            "labyrinth": self._text,
            "optimal_actions": self._optimal_actions[self._state].copy(),
            "distance": distance,
            "is_success": distance == 0,
        }

    def render(self) -> NDArray[np.uint8] | str | None:
        """Return the image, 600 x 600 x 3, or the drawing as text; or show it in a window.

        Raises:
            ResetNeeded: There is no labyrinth yet.
            DependencyNotInstalled: A window needs pygame.
        """
        if self.render_mode == "rgb_array":
            return render(self.labyrinth, self.state)
        if self.render_mode == "ansi":
            return draw_text(self.labyrinth, self.state)
        if self.render_mode == "human":
            self._show()
        return None

    def _show(self) -> None:
        caption = f"Labyrinth {self._id}"
        self.window().show(render(self.labyrinth, self.state), caption, self.metadata["render_fps"])

    def window(self) -> Window:
        """Return the window of this environment; open it first if necessary.

        Raises:
            DependencyNotInstalled: A window needs pygame.
        """
        if self._window is None:
            try:
                from labyrinth_core.env.window import Window
            except ImportError as error:
                raise DependencyNotInstalled(
                    "a window needs pygame: pip install 'labyrinth-datasets[play]'"
                ) from error
            self._window = Window()
        return self._window

    def close(self) -> None:
        """Close the window, if one is open."""
        if self._window is not None:
            self._window.close()
            self._window = None


def _checked(action: int | np.int64) -> int:
    """Return an action of any integer type, or an array or tensor without axes, as a Python int.

    Booleans, and arrays or tensors with axes, are refused, also with a single element.
    """
    if type(action) is int:  # The usual ones come first, since every step passes here.
        number = action
    elif type(action) is np.int64:
        number = int(action)
    elif "bool" in str(getattr(action, "dtype", type(action))) or getattr(action, "ndim", 0) > 0:
        number = -1
    else:
        try:
            number = index(action)
        except TypeError:
            number = -1
    if not 0 <= number < 4:
        shown = " ".join(str(action).split())
        raise ValueError(f"action={shown}: give 0 up, 1 right, 2 down or 3 left")
    return number
