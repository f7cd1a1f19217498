"""`LabyrinthVectorEnv` steps thousands of labyrinths at once, with a few array look-ups per step.

    gymnasium.make_vec("labyrinth_core.env:Labyrinth-v0", num_envs=1000, observation="state")

Each sub-environment behaves exactly like a `LabyrinthEnv` in Gymnasium's `SyncVectorEnv`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Discrete
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.env.environment import REWARDS, Kind, Observer
from labyrinth_core.env.labyrinth_source import (
    LabyrinthLike,
    Size,
    check_shape,
    checked_mask,
    checked_seeds,
    chosen,
    sources_of,
    step_limit,
    write_plainly,
)
from labyrinth_core.env.stack import NextLabyrinths, Stack
from labyrinth_core.language import draw_text
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE, Gallery, render
from labyrinth_core.world import BUCKETS, Labyrinth, Tables, Task

Mask = NDArray[np.bool_]
Batch = NDArray[Any]
Infos = dict[str, Any]

Frame = NDArray[np.uint8] | str

RENDER_MODES = ("rgb_array", "ansi", "rgb_array_list", "ansi_list")
PICTURE_MEMORY = 2**30
"""The default memory for cached pictures in bytes: room for 50,000 labyrinths of 5x5 at 64 x 64."""


class LabyrinthVectorEnv(VectorEnv[Batch, Batch, Batch]):
    """Many labyrinths of one size and task.

    Observations, rewards, ends and infos are those of `LabyrinthEnv`, batched as Gymnasium's
    `SyncVectorEnv` batches them. Sub-environment i of a vector seeded with s equals a
    `LabyrinthEnv` seeded with s + i. The caller may keep and change the returned arrays, except
    pictures with `copy=False`, and the string arrays in the infos, which are read-only and reused
    until a labyrinth changes.
    """

    _spec: EnvSpec | None = None

    def __init__(
        self,
        num_envs: int = 1,
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
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        copy: bool = True,
        picture_memory: int = PICTURE_MEMORY,
    ) -> None:
        """Make the environments; `reset` them before the first step.

        Args:
            num_envs: The number of sub-environments.
            size: As in `LabyrinthEnv`, like all arguments that are not explained here.
            task: The task of all sub-environments.
            observation: `state` is the fastest; `vector` takes a few times as long; `image` draws.
            image_size: Pixels on each side of the image.
            labyrinth: A labyrinth for every episode of every sub-environment.
            labyrinths: Fixed labyrinths, one per sub-environment, all of one size and task. If
                there are fewer, they are reused in turn. If there are more, sub-environment i
                begins with labyrinth i, or s + i after a reset with the seed s, and moves on by
                num_envs with every episode, modulo their number.
            split: Sample only structures of this split. Labyrinths are then sampled one by one.
            buckets: The percentages of all structures in the three splits.
            reward: `default` or `normalised`.
            max_episode_steps: A limit below `40 * width * height` steps.
            autoreset_mode: When a sub-environment begins its next episode: `NEXT_STEP`, at the step
                after the last of an episode; `SAME_STEP`, in that step; `DISABLED`, at `reset`.
            render_mode: What `render` returns for each: `rgb_array` or `ansi`; or `rgb_array_list`
                or `ansi_list`, all frames of the episode since the last call.
            copy: Whether each step returns a new array of pictures. Otherwise all steps return the
                same read-only array, which the next step changes.
            picture_memory: The most bytes for cached pictures, about 20 KB for each sub-environment
                of 5x5 at 64 x 64. Sub-environments that do not fit are redrawn at every step. The
                returned arrays do not count.

        Raises:
            ValueError: An argument has a value that is not allowed.
        """
        num_envs = whole("num_envs", num_envs, 1)
        if render_mode is not None:
            chosen("render_mode", render_mode, RENDER_MODES)
        self.num_envs = num_envs
        self._frames: list[list[Frame]] | None = None
        """The frames of each since the last `render`, if the mode is a list mode."""
        if render_mode is not None and render_mode.endswith("_list"):
            self._frames = [[] for _ in range(num_envs)]
        self.render_mode = render_mode
        self.autoreset_mode = chosen("autoreset_mode", autoreset_mode, AutoresetMode)
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": 10,
            "autoreset_mode": self.autoreset_mode,
        }
        self._sources = sources_of(size, task, labyrinth, labyrinths, split, buckets)
        self._turns: NDArray[np.int64] | None = None
        """The number of each sub-environment's next labyrinth, if there are more labyrinths."""
        if len(self._sources) > num_envs:
            self._turns = np.arange(num_envs)
        self._shape = self._sources[0].shape
        self._observer = Observer(observation, image_size)
        image_size = self._observer.image_size
        memory = whole("picture_memory", picture_memory, 0)
        self._gallery: Gallery | None = None
        if observation == "image":
            self._gallery = Gallery(num_envs, self._shape, image_size, memory, copy=copy)
        self._normalised = chosen("reward", reward, REWARDS) == "normalised"
        self._limit = step_limit(self._shape.height * self._shape.width, max_episode_steps)
        self.single_action_space = Discrete(4)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.single_observation_space = self._observer.space(*self._shape)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self._seeds: list[int | None] = [None] * num_envs
        self._stack = Stack(num_envs, *self._shape)
        self._next: NextLabyrinths | None = None
        samples_all = self._sources[0].kept is None and split is None
        if samples_all and NextLabyrinths.pay(num_envs, self._shape):
            self._next = NextLabyrinths(num_envs, self._shape, normalised=self._normalised)
        self._begun = np.zeros(num_envs, np.bool_)
        self._over = np.zeros(num_envs, np.bool_)
        self._steps = np.zeros(num_envs, np.int64)

    @property
    def spec(self) -> EnvSpec | None:
        """The specification to recreate these environments; None if not made by `make_vec`."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        values = self._sources[0].plainly() | {
            "num_envs": self.num_envs,
            "image_size": self._observer.image_size,
            "autoreset_mode": self.autoreset_mode.value,
        }
        given = {} if spec is None else spec.kwargs
        if given.get("max_episode_steps") is not None:
            values["max_episode_steps"] = self._limit
        if given.get("labyrinths") is not None:
            kept = [source.plainly()["labyrinth"] for source in self._sources]
            values |= {"labyrinth": None, "labyrinths": kept}
        self._spec = write_plainly(spec, values, self._limit)

    @property  # type: ignore[misc]  # Read-only, as in Gymnasium's own vector environments.
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The generator of each sub-environment."""
        generators = tuple(map(self._generator, range(self.num_envs)))
        if self._next is not None:  # Undo what was drawn ahead, before the caller draws.
            for slot, generator in enumerate(generators):
                self._next.forget(slot, generator)
        return generators

    @property
    def np_random_seed(self) -> tuple[int | None, ...]:  # type: ignore[override]
        """The seed of each sub-environment."""
        return tuple(self._seeds[slot] for slot, _ in enumerate(self.np_random))

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Batch, Infos]:
        """Begin an episode in every sub-environment, and return the observations and infos.

        Args:
            seed: A seed for each, or one to which each adds its index; None keeps the generators.
            options: As in `LabyrinthEnv.reset`, for all, but without `max_episode_steps`. The mask
                `reset_mask`, bool, shape (num_envs,), selects those that begin an episode; the
                others stay as they are.

        Raises:
            ResetNeeded: The mask leaves out sub-environments that have not begun any episode.
            ValueError: A seed, an option or the mask has a value that is not allowed.
        """
        options = dict(options or {})
        mask = checked_mask(options.pop("reset_mask", None), self.num_envs)
        if not (self._begun | mask).all():
            raise ResetNeeded("no episode is under way in some: call reset() without reset_mask")
        for slot, number in enumerate(checked_seeds(seed, self.num_envs)):
            if mask[slot] and number is not None:
                if self._next is not None:
                    self._next.forget(slot, None)
                self._generators[slot], self._seeds[slot] = seeding.np_random(number)
                if self._turns is not None:
                    self._turns[slot] = number % len(self._sources)
        self._restart(mask, options)
        self._collect(mask)
        return self._observe(), self._infos(mask)

    def _restart(self, mask: Mask, options: dict[str, Any] | None = None) -> None:
        """Begin an episode in the sub-environments of a mask."""
        begun = np.flatnonzero(mask)
        if self._next is not None and not options:
            begun = self._next.load(self._stack, begun, self._generator)
        slots = begun.tolist()
        # Draw all before loading any, so that an invalid option changes nothing.
        drawn = [self._draw(slot, options) for slot in slots]
        if self._turns is not None:
            self._turns[mask] += self.num_envs
        tables: dict[Labyrinth, Tables] = {}
        same: list[int] = []
        for slot, labyrinth in zip(slots, drawn, strict=True):
            if labyrinth is not self._stack.labyrinths[slot]:
                made = tables.get(labyrinth) or Tables.of(labyrinth, normalised=self._normalised)
                self._stack.load(slot, labyrinth, tables.setdefault(labyrinth, made))
            else:
                same.append(slot)
        if self._gallery is not None:
            self._gallery.forget(np.setdiff1d(np.flatnonzero(mask), same))
        self._stack.restart(mask)
        self._steps[mask] = 0
        self._over[mask] = False
        self._begun |= mask
        if self._frames is not None:
            for slot in np.flatnonzero(mask).tolist():
                self._frames[slot] = []

    def _draw(self, slot: int, options: dict[str, Any] | None) -> Labyrinth:
        number = slot if self._turns is None else self._turns[slot]
        source = self._sources[number % len(self._sources)]
        if source.kept is not None and not options:
            return source.kept
        generator = self._generator(slot)
        if self._next is not None:
            self._next.forget(slot, generator)
        labyrinth = source.draw(generator, options)
        check_shape(labyrinth, self._shape)
        return labyrinth

    def _generator(self, slot: int) -> np.random.Generator:
        generator = self._generators[slot]
        if generator is None:
            generator, self._seeds[slot] = seeding.np_random()
            self._generators[slot] = generator
        return generator

    def step(self, actions: Batch) -> tuple[Batch, Batch, Batch, Batch, Infos]:
        """Take an action in each, and return observations, rewards, ends and infos.

        Args:
            actions: Integers from 0 to 3, shape (num_envs,). The action of a sub-environment that
                begins its next episode in this step is ignored.

        Returns:
            Observations; rewards, float64; terminated and truncated, bool; infos. Each array has
            num_envs rows. With `SAME_STEP` the infos of an episode's last state are in
            `final_info`, and its observation in `final_obs`.

        Raises:
            ResetNeeded: An episode has not begun, or is over and `autoreset_mode` is `DISABLED`.
            ValueError: An action is not one of the four.
        """
        actions = self._checked_actions(actions)
        if not self._begun.all():
            raise ResetNeeded("no episode is under way: call reset() before step()")
        over = self._over.copy() if self._over.any() else None
        if over is not None and self.autoreset_mode is AutoresetMode.DISABLED:
            slots = ", ".join(map(str, np.flatnonzero(over)[:5]))
            raise ResetNeeded(
                f"the episodes of sub-environments {slots} are over: call "
                "reset(options={'reset_mask': ...}) for all that are"
            )
        rewards, terminated = self._stack.step(actions)
        self._steps += 1
        truncated = self._steps >= self._limit
        if over is not None:
            self._restart(over)
            rewards[over], terminated[over], truncated[over] = 0.0, False, False
        np.logical_or(terminated, truncated, out=self._over)
        final: Infos = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._over.any():
            final = self._finish(self._over.copy())
        self._collect()
        return self._observe(), rewards, terminated, truncated, final | self._infos()

    def _checked_actions(self, actions: Batch) -> NDArray[np.int64]:
        numbers = np.asarray(actions)
        if numbers.shape != (self.num_envs,) or numbers.dtype.kind not in "iu":
            raise ValueError(
                f"actions: give whole numbers of shape ({self.num_envs},), "
                f"not {numbers.dtype} of shape {numbers.shape}"
            )
        wrong = numbers[(numbers < 0) | (numbers > 3)]
        if wrong.size:
            raise ValueError(f"action={wrong[0]}: give 0 up, 1 right, 2 down or 3 left")
        return numbers.astype(np.int64)

    def _finish(self, over: Mask) -> Infos:
        """Return the last observations and infos of episodes, and begin the next ones."""
        observations = np.full(self.num_envs, None, object)
        slots = np.flatnonzero(over).tolist()
        last = self._observer.batch([self._stack.at(slot) for slot in slots])
        for slot, observation in zip(slots, last, strict=True):
            observations[slot] = observation.copy()  # An array of its own.
        final = {
            "final_obs": observations,
            "_final_obs": over.copy(),
            "final_info": self._infos(over),
            "_final_info": over.copy(),
        }
        self._restart(over)
        return final

    def _observe(self) -> Batch:
        if self._observer.kind == "state":
            return self._stack.states()
        if self._observer.kind == "vector":
            return self._stack.vectors()
        if self._gallery is not None:
            return self._gallery.pictures(self._stack)
        return self._observer.batch([self._stack.at(slot) for slot in range(self.num_envs)])

    def _infos(self, mask: Mask | None = None) -> Infos:
        """Return the infos of the sub-environments of a mask; the others have empty infos."""
        stacked = self._stack.infos()
        masks = np.empty((len(stacked), self.num_envs), np.bool_)  # Faster than an array for each.
        masks[:] = True if mask is None else mask
        infos: Infos = {}
        for (name, values), own in zip(stacked.items(), masks, strict=True):
            infos[f"_{name}"] = own
            infos[name] = values
            if mask is not None:
                only = np.full_like(values, None if values.dtype == object else 0)
                only[mask] = values[mask]
                infos[name] = only
        return infos

    def render(self) -> tuple[Any, ...] | None:
        """Return the picture, 600 x 600 x 3, or the text drawing of each sub-environment.

        In a list mode, return a list for each: all frames of the episode since the last call.

        Raises:
            ResetNeeded: An episode has not begun.
        """
        if self.render_mode is None:
            return None
        if not self._begun.all():
            raise ResetNeeded("there is no labyrinth yet: call reset() first")
        if self._frames is None:
            return tuple(map(self._frame, range(self.num_envs)))
        frames, self._frames = self._frames, [[] for _ in range(self.num_envs)]
        return tuple(frames)

    def _collect(self, mask: Mask | None = None) -> None:
        """Keep the frames of the sub-environments of a mask, if the mode is a list mode."""
        if self._frames is not None:
            for slot, frames in enumerate(self._frames):
                if mask is None or mask[slot]:
                    frames.append(self._frame(slot))

    def _frame(self, slot: int) -> Frame:
        assert self.render_mode is not None
        draw = draw_text if self.render_mode.startswith("ansi") else render
        labyrinth, state = self._stack.at(slot)
        return draw(labyrinth, labyrinth.state_at(state))
