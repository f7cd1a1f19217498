"""`LabyrinthEnv`: the labyrinth as a Gymnasium environment, a shell over `dynamics`.

    gymnasium.make("labyrinth_core.env:Labyrinth-v0", size=5, task="key_and_door")

Importing this module registers `Labyrinth-v0`; `vector_env` runs many of them in lock-step.
"""

from __future__ import annotations

from operator import index
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.error import DependencyNotInstalled, ResetNeeded
from gymnasium.spaces import Box, Discrete, Space
from numpy.typing import NDArray

from labyrinth_core.env.labyrinth_source import LabyrinthLike, LabyrinthSource, Size
from labyrinth_core.env.observation import DEFAULT_IMAGE_SIZE, Kind, Observation, Observer
from labyrinth_core.language.drawing import draw_text
from labyrinth_core.language.text import dump, labyrinth_id
from labyrinth_core.pictures.renderer import render
from labyrinth_core.pictures.vector import GONE, ICE, WALL, tile_count
from labyrinth_core.world.dynamics import STEP_LIMIT, State, state_at
from labyrinth_core.world.labyrinth import Labyrinth, Task
from labyrinth_core.world.state_tables import LabyrinthTables, tabulate

if TYPE_CHECKING:
    from labyrinth_core.env.window import Window

REWARDS = ("default", "normalised")
RENDER_MODES = ("rgb_array", "human", "ansi")


class LabyrinthEnv(gymnasium.Env[Observation, np.int64]):
    """An agent in a labyrinth, from the start to the goal.

    Actions: 0 up, 1 right, 2 down, 3 left. Rewards and ends of episodes are those of `dynamics`.
    An episode is truncated after `40 * width * height` steps.

    Each `reset` samples a fresh labyrinth, unless one was given to keep. All randomness comes
    from `np_random`, so a seed settles the labyrinth and those of all later episodes.

    `info`, of `reset` and `step` alike, is about the state that the agent is in now:

    - `labyrinth_id`: sixteen hexadecimal digits, the same on every machine.
    - `labyrinth`: the text that `language.parse` makes the same labyrinth of.
    - `optimal_actions`: which actions begin a shortest route to the goal, bool, shape (4,); none
      at the goal, on ice, or where no way leads to the goal.
    - `distance`: the least number of moves to the goal, -1 where no way leads there.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        size: Size = 5,
        task: Task | str = Task.NAVIGATION,
        *,
        observation: Kind = "image",
        image_size: int = DEFAULT_IMAGE_SIZE,
        labyrinth: LabyrinthLike | None = None,
        reward: str = "default",
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Make an environment; `reset` it before the first step.

        Args:
            size: Rows and columns, as `5`, `"4x6"` or `(4, 6)`, height first.
            task: What `Task` names.
            observation: `image`, exactly what `renderer.render` draws; `vector`, as
                `vector.vector_observation` has it; or `state`, the number of the state in
                `dynamics`, which says nothing of the walls: for tables on one labyrinth.
            image_size: Pixels on each side of the image; by default what the baselines look at.
            labyrinth: A labyrinth to keep for every episode: its text, the path of a file, or a
                `Labyrinth`. Size and task are then its own.
            reward: `default`, or `normalised`: the goal pays so much that an optimal episode
                returns exactly 1.
            max_episode_steps: Truncate sooner than after `40 * width * height` steps. The
                argument of that name to `gymnasium.make` does the same, by a wrapper. Neither
                makes episodes longer.
            render_mode: `rgb_array` (600 x 600 x 3), `human` (a window, shown at every step), or
                `ansi` (the drawing as text, `@` the agent).

        Raises:
            ValueError: An argument has a value that is impossible.
        """
        self.source = LabyrinthSource.of(size, task, labyrinth)
        self._observer = Observer(observation, image_size)
        self._normalised = is_normalised(reward)
        self._max_episode_steps = checked_step_limit(max_episode_steps)
        if render_mode not in (None, *RENDER_MODES):
            raise ValueError(f"render_mode={render_mode}: choose one of {', '.join(RENDER_MODES)}")
        self.render_mode = render_mode
        self.action_space = Discrete(4)
        self._fit_space(self.source.height, self.source.width, self.source.task)
        self._tables: LabyrinthTables | None = None
        self._window: Window | None = None
        self._over = True

    def _fit_space(self, height: int, width: int, task: Task) -> None:
        """Make the observation space that of labyrinths of a size and task."""
        shape = (height, width, task)
        if getattr(self, "_shape", None) != shape:
            self._shape = shape
            self.observation_space = observation_space(self._observer, height, width, task)

    @property
    def labyrinth(self) -> Labyrinth:
        """The labyrinth of this episode."""
        return self._now().labyrinth

    @property
    def state(self) -> State:
        """The state that the agent is in."""
        return state_at(self.labyrinth, self._state)

    def _now(self) -> LabyrinthTables:
        if self._tables is None:
            raise ResetNeeded("there is no labyrinth yet: call reset() first")
        return self._tables

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode, and return the first observation and its info.

        Args:
            seed: Settles this labyrinth and, without further seeds, all later ones.
            options: For this episode only: `labyrinth` (as in the constructor), `task`, `start`
                and `goal` (each `(row, column)`, row 0 at the bottom). Where task, start or goal
                differ from the labyrinth's own, the tiles of its task are placed anew. The
                observation space follows if a labyrinth of another size or task asks for it.

        Raises:
            ValueError: An option has no such name, or a value that is impossible.
        """
        super().reset(seed=seed)
        labyrinth = self.source.draw(self.np_random, options)
        if self._tables is None or self._tables.labyrinth is not labyrinth:
            self._load(labyrinth)
        self._state = self._now().initial
        self._steps = 0
        self._over = False
        if self.render_mode == "human":
            self._show()
        return self._observer.observe(labyrinth, self._state), self._info()

    def _load(self, labyrinth: Labyrinth) -> None:
        tables = tabulate(labyrinth, normalised=self._normalised)
        structure = labyrinth.structure
        self._fit_space(structure.height, structure.width, labyrinth.task)
        self._tables = tables
        self._text = dump(labyrinth)
        self._id = labyrinth_id(self._text)
        self._limit = episode_steps(structure.cells, self._max_episode_steps)
        # Lists: reading one item of an array takes several times as long.
        self._transitions: list[list[int]] = tables.transitions.tolist()
        self._rewards: list[float] = tables.rewards.tolist()
        self._terminal: list[bool] = tables.terminal.tolist()
        self._distances: list[int] = tables.distances.tolist()

    def step(self, action: int | np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take an action, and return observation, reward, terminated, truncated and info.

        Raises:
            ResetNeeded: The episode is over, or has not begun.
            ValueError: The action is none of the four.
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
        observation = self._observer.observe(self._now().labyrinth, state)
        return observation, self._rewards[state], terminated, truncated, self._info()

    def _info(self) -> dict[str, Any]:
        tables = self._now()
        return {
            "labyrinth_id": self._id,
            "labyrinth": self._text,
            "optimal_actions": tables.optimal_actions[self._state].copy(),
            "distance": self._distances[self._state],
        }

    def render(self) -> NDArray[np.uint8] | str | None:
        """Return the picture, 600 x 600 x 3, or the drawing as text; in a window, show it.

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
        """Return the window of this environment, opened if need be.

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
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None


def observation_space(observer: Observer, height: int, width: int, task: Task) -> Space[Any]:
    """Return the space of the observations of labyrinths of a size and task.

    - `image`: `Box(0, 255, (image_size, image_size, 3), uint8)`, rows from the top.
    - `vector`: `Box`, int32, as `vector.vector_observation` has it, each entry within its bounds.
    - `state`: `Discrete(states)`, the number that `dynamics.state_index` gives a state.
    """
    if observer.kind == "image":
        return Box(0, 255, (observer.image_size, observer.image_size, 3), np.uint8)
    if observer.kind == "state":
        return Discrete(height * width * (3 if task is Task.KEY_AND_DOOR else 1))
    entries, tiles = (2 * height - 1) * (2 * width - 1), tile_count(task)
    high = np.full(tiles + entries, ICE if task is Task.ICY_FLOOR else WALL, np.int32)
    high[:tiles] = entries - 1
    low = np.zeros_like(high)
    low[3:tiles] = GONE
    return Box(low, high, dtype=np.int32)


def is_normalised(reward: str) -> bool:
    """Return whether a kind of reward is the normalised one.

    Raises:
        ValueError: There is no such kind.
    """
    if reward not in REWARDS:
        raise ValueError(f"reward={reward}: choose one of {', '.join(REWARDS)}")
    return reward == "normalised"


def checked_step_limit(max_episode_steps: int | None) -> int | None:
    """Return the limit, if it makes sense.

    Raises:
        ValueError: It is below 1.
    """
    if max_episode_steps is not None and max_episode_steps < 1:
        raise ValueError(f"max_episode_steps={max_episode_steps}: give a whole number from 1 on")
    return max_episode_steps


def episode_steps(cells: int, max_episode_steps: int | None) -> int:
    """Return after how many steps an episode is truncated."""
    limit = STEP_LIMIT * cells
    return limit if max_episode_steps is None else min(limit, max_episode_steps)


def _checked(action: int | np.int64) -> int:
    """Return an action as a plain number, which may come as any of NumPy's."""
    try:
        number = index(action)
    except TypeError:
        number = -1
    if not 0 <= number < 4:
        raise ValueError(f"action={action}: give 0 up, 1 right, 2 down or 3 left")
    return number
