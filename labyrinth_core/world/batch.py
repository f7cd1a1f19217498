"""Thousands of structures and labyrinths in arrays: check their rules, replay episodes, tabulate.

Tables over numbered states, of one labyrinth or of many, turn a step into a look-up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.rules import RULES, Action, Look, State, Task
from labyrinth_core.world.solver import Solver
from labyrinth_core.world.structure import DIAGONALS, UNREACHABLE, Structure


@dataclass(frozen=True, eq=False)
class Structures:
    """n structures of one size."""

    height: int
    width: int
    up: NDArray[np.bool_]
    """Whether each cell has a passage to the cell above, shape (n, cells)."""
    right: NDArray[np.bool_]
    """Whether each cell has a passage to the cell on the right, shape (n, cells)."""

    @classmethod
    def of(cls, structures: Sequence[Structure]) -> Structures:
        """Collect one or more structures of the same size."""
        height, width, cells = structures[0].height, structures[0].width, structures[0].cells
        text = "".join("".join(each.digits()) for each in structures)
        is_open = np.frombuffer(text.encode(), np.uint8).reshape(-1, 2, cells) == ord("1")
        return cls(height, width, is_open[:, 0], is_open[:, 1])

    def __len__(self) -> int:
        return len(self.up)

    def __getitem__(self, index: int) -> Structure:
        up, right = (
            int.from_bytes(np.packbits(passages[index], bitorder="little").tobytes(), "little")
            for passages in (self.up, self.right)
        )
        return Structure(self.height, self.width, up, right)

    @property
    def default_ends(self) -> tuple[int, int]:
        """As `Structure.default_ends`: the bottom left and the top right cell."""
        return 0, self.height * self.width - 1

    def moves(self) -> NDArray[np.int32]:
        """Return `Structure.moves` of each: where the actions lead, shape (n, cells, 4)."""
        moves = np.empty((*self.up.shape, 4), np.int32)
        moves[:] = np.arange(self.height * self.width)[:, None]
        for passages, step, onward, back in (
            (self.up, self.width, Action.UP, Action.DOWN),
            (self.right, 1, Action.RIGHT, Action.LEFT),
        ):
            moves[:, :, onward] += step * passages
            moves[:, step:, back] -= step * passages[:, :-step]
        return moves


@dataclass(frozen=True, eq=False)
class Labyrinths:
    """n labyrinths of one size, task and look; no two tiles of a labyrinth share a cell.

    States are numbered as in `Labyrinth.state_index`.
    """

    structures: Structures
    task: Task
    look: Look
    tiles: NDArray[np.int64]
    """The cells of start and goal, then of key and door if any, shape (n, 2) or (n, 4)."""
    ground: NDArray[np.uint8]
    """What each cell shows, shape (n, cells): 0 for the floor, 1 for the first of the task's
    `grounds`, and so on."""

    @classmethod
    def of(cls, labyrinths: Sequence[Labyrinth]) -> Labyrinths:
        """Collect one or more labyrinths of the same size, task and look."""
        structures = Structures.of([each.structure for each in labyrinths])
        first = labyrinths[0]
        singles = ("start", "goal", *first.task.rules.singles)
        tiles = [[getattr(each, name) for name in singles] for each in labyrinths]
        ground = np.zeros(structures.up.shape, np.uint8)
        for number, name in enumerate(first.task.rules.grounds, start=1):
            for row, each in zip(ground, labyrinths, strict=True):
                row[list(getattr(each, name))] = number
        return cls(structures, first.task, first.look, np.array(tiles, np.int64), ground)

    def __len__(self) -> int:
        return len(self.tiles)

    def take(self, numbers: NDArray[np.int64]) -> Labyrinths:
        """Return the labyrinths with the given numbers."""
        up, right = (passages[numbers] for passages in (self.structures.up, self.structures.right))
        return replace(
            self,
            structures=replace(self.structures, up=up, right=right),
            tiles=self.tiles[numbers],
            ground=self.ground[numbers],
        )

    @property
    def ice(self) -> NDArray[np.bool_]:
        """Whether there is ice in each cell, shape (n, cells)."""
        grounds = self.task.rules.grounds
        ice: NDArray[np.bool_] = (
            self.ground == 1 + grounds.index("ice")
            if "ice" in grounds
            else np.zeros(self.ground.shape, np.bool_)
        )
        return ice

    def keep_the_rules(self) -> bool:
        """Return whether every labyrinth keeps the rules of `Labyrinth`."""
        count, cells = self.ground.shape
        first = cells * np.arange(count)
        onward = self.structures.moves().reshape(-1, 4) + np.repeat(first, cells)[:, None]
        start, goal, *locked = (self.tiles + first[:, None]).T
        kept = distances_from(onward, goal, np.flatnonzero(self.ice))[start] != UNREACHABLE
        if locked:
            key, door = locked
            before_door = distances_from(onward, start, door) != UNREACHABLE
            kept &= before_door[key] & ~before_door[goal]
        return bool(kept.all())

    def transitions(self) -> NDArray[np.int32]:
        """Return the state that each action leads to, shape (n, states, 4).

        Rows of impossible states are meaningless, as in `Labyrinth.transition_table`.
        """
        moves = self.structures.moves()
        if self.task is not Task.KEY_AND_DOOR:
            return moves
        cells = self.ground.shape[1]
        key, door = (self.tiles[:, column, None, None] for column in (2, 3))
        stay = np.arange(cells, dtype=np.int32)[:, None]
        without_key = np.where(moves == door, stay, moves) + cells * (moves == key)
        with_key = cells + moves + cells * (moves == door)
        return np.concatenate([without_key, with_key, 2 * cells + moves], axis=1, dtype=np.int32)

    def terminal(self) -> NDArray[np.bool_]:
        """Return whether an episode ends in each state, shape (n, states)."""
        ends = self.ice
        np.put_along_axis(ends, self.tiles[:, 1:2], True, axis=1)
        return np.tile(ends, self.task.rules.phases)

    def replay(
        self,
        which: NDArray[np.int64],
        firsts: NDArray[np.int64],
        actions: NDArray[np.int64],
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]] | None:
        """Return the states of all episodes, concatenated, and whether each state is terminal.

        The labyrinths must keep the rules. All episodes advance together, one step at a time.

        Args:
            which: The number of each episode's labyrinth.
            firsts: The index of each episode's first state in the result, ascending from 0.
            actions: The action taken in each state, 0 to 3; arbitrary in an episode's last state.

        Returns:
            The index of each state and whether an episode ends there, shape (len(actions),) each;
            None if an episode continues after a terminal state.
        """
        transitions, terminal = self.transitions(), self.terminal()
        states_of_one = terminal.shape[1]
        offset = states_of_one * which
        onward = transitions.ravel()
        ends = np.append(firsts[1:], len(actions))
        longest_first = np.argsort(firsts - ends, kind="stable")
        lengths = (ends - firsts)[longest_first]
        row, offset = firsts[longest_first], offset[longest_first]
        now = self.tiles[which[longest_first], 0]
        states = np.empty(len(actions), np.int64)
        for step in range(lengths[0]):
            going = np.searchsorted(-lengths, -step)
            row, offset, now = row[:going], offset[:going], now[:going]
            states[row] = now
            now = onward.take(4 * (offset + now) + actions.take(row))
            row = row + 1
        over = terminal.ravel()[states_of_one * np.repeat(which, ends - firsts) + states]
        last = np.zeros(len(actions), np.bool_)
        last[ends - 1] = True
        return None if (over & ~last).any() else (states, over)


@dataclass(frozen=True, eq=False)
class Tables:
    """Everything that an environment needs to know of a labyrinth, or of several, precomputed.

    For several labyrinths, each array has an additional first axis over the labyrinths.
    """

    initial: int
    """Index of the state in which an episode begins."""
    transitions: NDArray[np.int32]
    """Index of the state that each action leads to, shape (states, 4)."""
    rewards: NDArray[np.float64]
    """Reward of a step that leads to the state, shape (states,)."""
    terminal: NDArray[np.bool_]
    """Whether the episode ends in the state, shape (states,)."""
    distances: NDArray[np.int64]
    """Least moves to the goal, -1 where no route leads there, shape (states,)."""
    optimal_actions: NDArray[np.bool_]
    """Which actions begin a shortest route, shape (states, 4)."""

    @classmethod
    def of(cls, labyrinth: Labyrinth, *, normalised: bool = False) -> Tables:
        """Return the tables of a labyrinth; arrays are read-only.

        Args:
            labyrinth: The labyrinth to tabulate.
            normalised: Whether to raise the goal's reward so that an optimal episode returns 1.
        """
        cells, count = labyrinth.structure.cells, labyrinth.state_count
        solver = Solver(labyrinth)
        first, start = labyrinth.initial, labyrinth.start
        rewards = np.full(count, labyrinth.reward(first))
        terminal = np.zeros(count, np.bool_)
        for cell in (labyrinth.goal, *labyrinth.ice):
            rewards[cell::cells] = labyrinth.reward(State(cell))
            terminal[cell::cells] = labyrinth.is_terminal(State(cell))
        if normalised:
            rewards[labyrinth.goal :: cells] += (solver.moves - 1) * RULES.step_penalty / cells
        arrays = (
            np.array(solver.table, np.int32),
            rewards,
            terminal,
            np.array(solver.distances, np.int64),
            solver.optimal_actions(),
        )
        for array in arrays:
            array.setflags(write=False)
        return cls(start, *arrays)

    @classmethod
    def of_many(
        cls, structures: Structures, start: int, goal: int, *, normalised: bool = False
    ) -> Tables:
        """Return the tables of labyrinths without key, door and ice, so that a state is a cell.

        Args:
            structures: Their structures, all connected.
            start: The start cell of all of them.
            goal: The goal cell of all of them.
            normalised: As for `of`.
        """
        count, cells = structures.up.shape
        transitions = structures.moves()
        onward = transitions + (cells * np.arange(count))[:, None, None]
        distances = distances_from(onward.reshape(-1, 4), goal + cells * np.arange(count))
        after = distances[onward]
        distances = distances.reshape(count, cells)
        rewards = np.full((count, cells), -RULES.step_penalty / cells)
        rewards[:, goal] = RULES.goal_reward
        if normalised:
            rewards[:, goal] += (distances[:, start] - 1) * RULES.step_penalty / cells
        terminal = np.zeros((count, cells), np.bool_)
        terminal[:, goal] = True
        optimal = after == distances[:, :, None] - 1
        return cls(start, transitions, rewards, terminal, distances, optimal)


def distances_from(
    onward: NDArray[np.int64],
    origins: NDArray[np.int64],
    blocked: NDArray[np.int64] | None = None,
) -> NDArray[np.int64]:
    """Return each cell's distance from its labyrinth's origin in moves, breadth first, shape (N,).

    Args:
        onward: The cells that the four actions lead to from each cell, shape (N, 4).
        origins: The origin in each labyrinth.
        blocked: Cells that are never entered.
    """
    moves, distances = 0, np.full(len(onward), UNREACHABLE)
    claims = np.empty(len(onward), np.int64)
    border = origins
    blocked = claims[:0] if blocked is None else blocked
    distances[blocked] = 0
    while len(border):
        distances[border] = moves
        moves += 1
        beside = onward[border].ravel()
        beside = beside[distances[beside] == UNREACHABLE]
        # A cell beside several border cells is kept once: the last claim wins.
        numbers = np.arange(len(beside))
        claims[beside] = numbers
        border = beside[claims[beside] == numbers]
    distances[blocked] = UNREACHABLE
    return distances


def seen_together(
    moves: NDArray[np.int64], agents: NDArray[np.int64], side: int
) -> NDArray[np.bool_]:
    """Return which of the N cells of many structures are visible, as `Structure.visible_from`.

    Args:
        moves: The cells that the four actions lead to from each cell, shape (N, 4).
        agents: The cell of the agent in each structure.
        side: The larger of the structures' height and width.

    Returns:
        Whether an agent sees the cell, shape (N,).
    """
    flat = moves.ravel()
    seen = np.zeros(len(moves), np.bool_)
    seen[agents] = True
    for action in Action:
        at = agents
        for _ in range(side - 1):
            at = flat.take(4 * at + action)  # A wall leads back to a cell already seen.
            seen[at] = True
    for across, updown in DIAGONALS:
        at = agents
        for _ in range(side - 1):
            beside = flat.take(4 * at + across)
            onward = flat.take(4 * beside + updown)
            at = np.where((beside != at) & (onward != beside), onward, at)
            seen[at] = True
    return seen
