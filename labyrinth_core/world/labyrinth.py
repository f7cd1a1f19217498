"""`Labyrinth`: which ones are valid, and the dynamics that all rooms share; `Episode`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.world.rules import (
    RULES,
    TILES,
    LabyrinthError,
    Look,
    State,
    Task,
)
from labyrinth_core.world.structure import UNREACHABLE, Moves, Structure

_WITH_TILES = [(t, t.rules.singles, t.rules.grounds) for t in Task if t.rules.tiles]
_SINGLES = ("start", "goal", *(tile.name for tile in TILES if not tile.many))
_GROUNDS = tuple(tile.name for tile in TILES if tile.many)


@dataclass(frozen=True)
class Labyrinth:
    """A structure with a start, a goal, and a task with its tiles. Cells are indices.

    Every instance is solvable and keeps the rules of its task.

    Raises:
        LabyrinthError: The labyrinth is not solvable or breaks a rule; checked at construction.
    """

    structure: Structure
    start: int
    goal: int
    task: Task = Task.NAVIGATION
    key: int | None = None
    door: int | None = None
    ice: frozenset[int] = frozenset()
    look: Look = Look.PLAIN

    def __post_init__(self) -> None:
        self._make_whole()
        own = vars(self)
        for task, singles, grounds in _WITH_TILES:
            needed = task is self.task
            wrong = bool(grounds) and any(map(own.__getitem__, grounds)) is not needed
            for name in singles:
                wrong = wrong or (own[name] is not None) is not needed
            if wrong:
                raise LabyrinthError(f"only {task} has {task.rules.owned}")
        cells = self.structure.cells
        taken: dict[int, str] = {}
        tiles = [("start", self.start), ("goal", self.goal)]
        if self.task.rules.tiles:
            tiles += self.tiles()
        for name, cell in tiles:
            if not 0 <= cell < cells:
                raise LabyrinthError(f"the {name} is outside the grid: cell {cell}")
            if cell in taken:
                raise LabyrinthError(f"the {taken[cell]} and the {name} share a cell", cell)
            taken[cell] = name
        if self.cell_distances[self.start] == UNREACHABLE:
            without = " without ice" if self.ice else ""
            raise LabyrinthError(f"no route{without} leads from start to goal", self.goal)
        if self.key is not None and self.door is not None:
            before_door = self.structure.distances(self.start, [self.door])
            if before_door[self.goal] != UNREACHABLE:
                raise LabyrinthError("a route from start to goal avoids the door", self.door)
            if before_door[self.key] == UNREACHABLE:
                raise LabyrinthError("the key cannot be reached without passing the door", self.key)

    def __reduce__(self) -> tuple[object, ...]:
        return Labyrinth, tuple(getattr(self, each.name) for each in fields(self))

    def _make_whole(self) -> None:
        """Convert NumPy integers to ints and texts to enum members; refuse all other types."""
        for name, kind in (("task", Task), ("look", Look)):
            value = getattr(self, name)
            if type(value) is not kind:
                if value not in [*kind]:
                    raise LabyrinthError(f"{name}={value}: choose one of {', '.join(kind)}")
                object.__setattr__(self, name, kind(value))
        for name in _SINGLES:
            cell = getattr(self, name)
            if type(cell) is not int and cell is not None:
                object.__setattr__(self, name, whole(name, cell))
        for name in _GROUNDS:
            cells = getattr(self, name)
            if type(cells) is not frozenset or any(type(cell) is not int for cell in cells):
                object.__setattr__(self, name, frozenset(whole(name, cell) for cell in cells))

    def tiles(self) -> Iterator[tuple[str, int]]:
        """Yield the name and the cell of each tile of the task."""
        for tile in self.task.rules.tiles:
            cells = getattr(self, tile.name)
            if tile.many:
                yield from ((tile.name, cell) for cell in cells)
            elif cells is not None:
                yield tile.name, cells

    @cached_property
    def cell_distances(self) -> Sequence[int]:
        """The least number of moves from each cell to the goal, avoiding ice; the door is open."""
        return self.structure.distances(self.goal, self.ice)

    @property
    def size_name(self) -> str:
        """The height and the width, such as `4x6`."""
        return f"{self.structure.height}x{self.structure.width}"

    def position(self, cell: int) -> tuple[int, int]:
        """Return the `(row, column)` of a cell."""
        return divmod(cell, self.structure.width)

    @property
    def initial(self) -> State:
        """The state in which an episode begins."""
        return State(self.start)

    def transition(self, state: State, action: int) -> State:
        """Return the state after `action`; a wall or a locked door leaves the agent in place."""
        agent, has_key, door_open = state
        target = self.structure.moves[agent][action]
        if target == self.door and not door_open:
            if not has_key:
                return state
            door_open = True
        return State(target, has_key or target == self.key, door_open)

    def is_terminal(self, state: State) -> bool:
        """Return whether the episode ends in `state`: on the goal, or on ice."""
        return state.agent == self.goal or state.agent in self.ice

    def reward(self, state: State) -> float:
        """Return the reward of the step that led to `state`."""
        if state.agent == self.goal:
            return RULES.goal_reward
        if state.agent in self.ice:
            return RULES.ice_reward
        return -RULES.step_penalty / self.structure.cells

    @property
    def step_limit(self) -> int:
        """The number of steps after which an episode is truncated."""
        return RULES.step_limit * self.structure.cells

    @property
    def state_count(self) -> int:
        """The number of states: the cells, times three with a door (locked, key held, open)."""
        return self.structure.cells * self.task.rules.phases

    def state_index(self, state: State) -> int:
        """Return a state's index: its cell, plus the cell count for the key, and for the door."""
        return state.agent + self.structure.cells * (state.has_key + state.door_open)

    def state_at(self, index: int) -> State:
        """Return the state with the given index; the inverse of `state_index`."""
        phase, agent = divmod(index, self.structure.cells)
        return State(agent, phase >= 1, phase == 2)

    def replay(self, actions: Iterable[int]) -> Episode:
        """Return the episode in which the agent takes `actions` from the initial state.

        Raises:
            ValueError: An action is not one of the four, or comes after the end of the episode.
        """
        states = [self.initial]
        taken: list[int] = []
        for action in actions:
            if not 0 <= action < 4:
                raise ValueError(f"action {action}: the actions are 0, 1, 2 and 3")
            if self.is_terminal(states[-1]):
                raise ValueError(
                    f"the episode ends after {len(taken)} steps, but an action follows"
                )
            states.append(self.transition(states[-1], action))
            taken.append(action)
        return _episode(self, states, taken)

    def transition_table(self) -> list[Moves]:
        """Return, for each state, the indices of the states that the four actions lead to.

        Rows of impossible states are meaningless: on a closed door, or on the key without it.
        """
        moves, cells = self.structure.moves, self.structure.cells
        key, door = self.key, self.door
        if key is None or door is None:
            return moves
        # Where the agent steps neither on the key nor through the door, only its cell changes.
        table = [
            (up + others, right + others, down + others, left + others)
            for others in range(0, self.state_count, cells)
            for up, right, down, left in moves
        ]
        beside = {key, door, *moves[key], *moves[door]}
        for index in [*beside, *(cell + cells for cell in beside)]:
            state = self.state_at(index)
            up, right, down, left = (
                self.state_index(self.transition(state, action)) for action in range(4)
            )
            table[index] = up, right, down, left
        return table


class Sketch(Labyrinth):
    """What a drawing shows, only to be drawn: it may lack tiles, or have no route to the goal."""

    def __post_init__(self) -> None:
        self._make_whole()


@dataclass(frozen=True, eq=False)
class Episode:
    """The states, actions and rewards of one episode, from the initial state of a labyrinth."""

    labyrinth: Labyrinth
    states: tuple[State, ...]
    """The T + 1 states visited."""
    actions: NDArray[np.int8]
    """The action taken in each state but the last, shape (T,)."""
    rewards: NDArray[np.float32]
    """The reward received for each action, shape (T,)."""

    def __post_init__(self) -> None:
        steps = len(self.states) - 1
        if not len(self.actions) == len(self.rewards) == steps:
            raise ValueError(
                f"an episode of {steps + 1} states has {steps} actions and rewards, "
                f"not {len(self.actions)} and {len(self.rewards)}"
            )
        self.actions.setflags(write=False)
        self.rewards.setflags(write=False)

    @classmethod
    def random(cls, labyrinth: Labyrinth, rng: np.random.Generator, max_steps: int) -> Episode:
        """Return an episode of uniformly random actions, truncated after `max_steps`.

        Raises:
            ValueError: `max_steps` is not a non-negative integer.
        """
        actions = rng.integers(4, size=whole("max_steps", max_steps, 0)).tolist()
        states = [labyrinth.initial]
        for action in actions:
            states.append(labyrinth.transition(states[-1], action))
            if labyrinth.is_terminal(states[-1]):
                break
        return _episode(labyrinth, states, actions[: len(states) - 1])

    def __len__(self) -> int:
        """Return the number of moves."""
        return len(self.actions)

    @property
    def terminated(self) -> bool:
        """Whether the episode ends on the goal or on ice, as opposed to being truncated."""
        return self.labyrinth.is_terminal(self.states[-1])


def _episode(labyrinth: Labyrinth, states: list[State], actions: list[int]) -> Episode:
    rewards = [labyrinth.reward(state) for state in states[1:]]
    return Episode(
        labyrinth, tuple(states), np.array(actions, np.int8), np.array(rewards, np.float32)
    )
