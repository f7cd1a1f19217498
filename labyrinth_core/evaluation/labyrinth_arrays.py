"""The labyrinths of a split as arrays, indexed by the states of all labyrinths.

Evaluation, labelling and rollouts become look-ups, without the environment. The arrays are computed
from the column `info` and the actions; pictures are drawn, and equal those in `obs`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import Dataset, Selection
from labyrinth_core.errors import DatasetError
from labyrinth_core.language import labyrinth_id
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE, Looks, ObservationSpec
from labyrinth_core.world import RULES, Labyrinth, Tables

if TYPE_CHECKING:
    from pyarrow.compute import Expression

STATE_BYTES = 250
"""The memory that each state takes while labyrinths are loaded, besides its observation: 210 to 237
bytes in 10,000 labyrinths of 5x5, 400 of 25x25 and 60 of 100x100, 114 of them in arrays."""

JOINED = 1_000
"""The number of labyrinths whose arrays are joined at once: thousands of small ones take twice the
memory of what they hold."""

Place = tuple[int, int]
"""The id of a labyrinth, and the index of a state in it as in `Labyrinth.state_index`."""


@dataclass(frozen=True, eq=False)
class LabyrinthArrays:
    """L labyrinths of one size and task, and the S states that episodes in them can visit.

    States that no episode reaches are left out: those behind the goal or ice, and those on a
    closed door. Goal and ice are terminal states: every action in them leads back to them with
    reward 0 and ends the episode, so that look-ups need no special case.
    """

    observations: NDArray[Any] | Looks
    """The observation of each state: uint8 (S, size, size, 3), int32 vectors (S, length), or texts
    (S,). More than 1 GiB of them is not held, but made whenever states are indexed."""
    labyrinth: NDArray[np.int64]
    """The index of the state's labyrinth, from 0 to L - 1, ascending, shape (S,)."""
    state: NDArray[np.int64]
    """The index of the state in its labyrinth, as in `Labyrinth.state_index`, ascending within each
    labyrinth, shape (S,)."""
    position: NDArray[np.int64]
    """The agent's cell, shape (S,)."""
    terminal: NDArray[np.bool_]
    """Whether the state is goal or ice, shape (S,)."""
    goal: NDArray[np.bool_]
    """Whether the state is the goal, shape (S,)."""
    next_state: NDArray[np.int64]
    """The state that each action leads to, shape (S, 4); a wall leads back."""
    rewards: NDArray[np.float32]
    """The reward of each action, shape (S, 4)."""
    done: NDArray[np.bool_]
    """Whether each action ends the episode, on the goal or on ice, shape (S, 4)."""
    optimal: NDArray[np.bool_]
    """Whether each action begins a shortest route, shape (S, 4); all False in goal and ice."""
    initial: NDArray[np.int64]
    """The state with the agent on each labyrinth's start, shape (L,)."""
    distance: NDArray[np.int64]
    """The number of moves on a shortest route, shape (L,)."""
    labyrinth_ids: NDArray[np.int64]
    """The ids in the order of the dataset, shape (L,); files hold them as `f"{id:016x}"`."""
    routes: tuple[NDArray[np.int64], ...]
    """The actions of each episode of the dataset, in its order."""
    route_starts: NDArray[np.int64]
    """The state in which each episode of `routes` begins, shape (episodes,).

    Pieces of routes may begin in any state."""
    labyrinths: tuple[Labyrinth, ...]
    """The L labyrinths."""
    spec: ObservationSpec
    """How the states are observed."""
    cells: int
    """The number of cells of a labyrinth."""

    @cached_property
    def places(self) -> Mapping[Place, int]:
        """The index of the state in each place, in ascending order."""
        ids, states = self.labyrinth_ids[self.labyrinth].tolist(), self.state.tolist()
        return {place: index for index, place in enumerate(zip(ids, states, strict=True))}

    @classmethod
    def of(
        cls, selection: Selection, spec: ObservationSpec, *, hold: bool = True
    ) -> LabyrinthArrays:
        """Return the labyrinths of a split, or of a part of it, as arrays; see `load_arrays`.

        Args:
            selection: The split or its part.
            spec: How the states are observed.
            hold: Whether to hold the observations if they take 1 GiB or less; False where each
                state is observed once or never.
        """
        held: dict[int, Labyrinth] = {}
        episodes: list[tuple[Place, NDArray[np.int64]]] = []
        try:
            for block in selection.replayed():
                ids, (rows, firsts, lasts) = block.ids.tolist(), block.whole
                for number, labyrinth in zip(ids, block.parsed(), strict=True):
                    held.setdefault(number, labyrinth).structure.free()
                for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
                    place = ids[block.which[first]], int(block.states[first])
                    episodes.append((place, rows.actions[first:last].copy()))
            if not held:
                raise DatasetError(f"split={selection.split} has no episodes")
            return _stack(list(held.values()), list(held), episodes, spec, hold=hold)
        except MemoryError as error:
            count = selection.total_labyrinths
            needed = (
                STATE_BYTES * count * max((each.state_count for each in held.values()), default=0)
            )
            raise DatasetError(
                f"split={selection.split}: the states of {count:,} labyrinths take about "
                f"{needed / 1e9:,.1f} GB, and what is seen in them up to 1 GB, more than there is "
                "memory: give fewer labyrinths"
            ) from error

    @classmethod
    def of_labyrinths(
        cls,
        labyrinths: Sequence[Labyrinth],
        spec: ObservationSpec,
        routes: Iterable[Iterable[NDArray[np.int64]]] = (),
    ) -> LabyrinthArrays:
        """Return labyrinths of one size and task as arrays.

        States are observed when they are indexed, since a policy sees few of those of large
        labyrinths.

        Args:
            labyrinths: The labyrinths.
            spec: How the states are observed.
            routes: The actions of the episodes of each labyrinth, which begin at its start.
        """
        ids = [int(labyrinth_id(each), 16) for each in labyrinths]
        episodes = [
            ((number, labyrinth.state_index(labyrinth.initial)), actions)
            for number, labyrinth, of_one in zip(ids, labyrinths, routes, strict=False)
            for actions in of_one
        ]
        return _stack(labyrinths, ids, episodes, spec, hold=False)

    def numbers_of(self, places: Sequence[Place]) -> NDArray[np.int64]:
        """Return the index of the state in each of N places, shape (N,).

        Raises:
            DatasetError: A place cannot be reached from the start of its labyrinth.
        """
        return _numbers_of(places, self.labyrinth_ids, self.labyrinth, self.state)

    def walk(
        self, starts: NDArray[np.int64], routes: Iterable[NDArray[np.int64]]
    ) -> Iterator[NDArray[np.int64]]:
        """Yield the T + 1 states that each route visits, shape (T + 1,).

        Args:
            starts: The state in which each route begins, shape (routes,).
            routes: The T actions of each route, shape (T,).
        """
        for state, actions in zip(starts.tolist(), routes, strict=True):
            states = [state]
            for action in actions.tolist():
                states.append(int(self.next_state[states[-1], action]))
            yield np.array(states)

    @cached_property
    def demonstrated(self) -> NDArray[np.int64]:
        """How often the episodes of the dataset take each action, shape (S, 4)."""
        counts = np.zeros(self.next_state.shape, np.int64)
        walked = self.walk(self.route_starts, self.routes)
        for states, actions in zip(walked, self.routes, strict=True):
            np.add.at(counts, (states[:-1], actions), 1)
        return counts

    @property
    def on_demonstration(self) -> NDArray[np.bool_]:
        """Whether an episode of the dataset acts in the state, shape (S,)."""
        on: NDArray[np.bool_] = self.demonstrated.sum(axis=1) > 0
        return on

    @property
    def step_limit(self) -> int:
        """The number of steps after which an episode is cut."""
        return RULES.step_limit * self.cells


def _numbers_of(
    places: Sequence[Place],
    ids: NDArray[np.int64],
    labyrinth: NDArray[np.int64],
    state: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Return the index of the state in each place, given arrays of a `LabyrinthArrays`."""
    index = {number: row for row, number in enumerate(ids.tolist())}
    pairs = [(index.get(number, -1), row) for number, row in places]
    asked = np.array(pairs, np.int64).reshape(-1, 2)
    # One ascending number for each pair of a labyrinth and a state.
    apart = int(max(state.max(), asked[:, 1].max(initial=0))) + 1
    known, keys = labyrinth * apart + state, asked[:, 0] * apart + asked[:, 1]
    numbers: NDArray[np.int64] = known.searchsorted(keys).clip(max=len(known) - 1)
    for row in np.flatnonzero(known[numbers] != keys).tolist():
        raise DatasetError(
            f"labyrinth {places[row][0]:016x}: an episode begins where the agent cannot get"
        )
    return numbers


def load_arrays(
    source: str | Path,
    config: str,
    split: str,
    *,
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    resize: str = "area",
    revision: str | None = None,
    labyrinths: int | None = None,
    where: Expression | None = None,
) -> LabyrinthArrays:
    """Return the labyrinths of a split as arrays.

    Args:
        source: Folder with the dataset, or its id on the Hub such as `user/labyrinth`.
        config: Name of the dataset's config, such as `5x5` or `5x5-key_and_door`.
        split: Name of the split, such as `train`.
        observation: "image", "vector" or "text".
        image_size: Pixels on each side of the pictures.
        resize: How pictures are made smaller, one of `pictures.observations.RESIZES`.
        revision: Branch, tag or commit on the Hub; not for folders.
        labyrinths: Number of labyrinths, the first ones; see `load_episodes`, also for `where`.
        where: A filter of the table of labyrinths.

    Raises:
        ValueError: An argument has a value that is not allowed.
        DatasetError: The dataset or split does not exist, or its rows do not form episodes.
    """
    spec = ObservationSpec(observation, image_size, draw=True, resize=resize)
    data = Dataset(source, config, revision)
    return LabyrinthArrays.of(data[split].filter(where, labyrinths=labyrinths), spec)


def _stack(
    labyrinths: Sequence[Labyrinth],
    ids: Sequence[int],
    episodes: Sequence[tuple[Place, NDArray[np.int64]]],
    spec: ObservationSpec,
    *,
    hold: bool,
) -> LabyrinthArrays:
    blocks: list[dict[str, NDArray[Any]]] = []
    parts: list[dict[str, NDArray[Any]]] = []
    first: list[int] = []
    distance: list[int] = []
    count = 0
    for number, labyrinth in enumerate(labyrinths):
        tables = Tables.of(labyrinth)
        states = _visitable(tables)
        first.append(count + states.index(tables.initial))
        distance.append(int(tables.distances[tables.initial]))
        part = _columns(tables, labyrinth.structure.cells, states, count)
        parts.append(part | {"labyrinth": np.full(len(states), number), "state": np.array(states)})
        count += len(states)
        labyrinth.structure.free()
        if len(parts) == JOINED:
            blocks.append(_joined(parts))
            parts = []
    joined = _joined(blocks + parts)
    which, state = joined["labyrinth"], joined["state"]
    looks = Looks(spec, labyrinths, which, state)
    starts = _numbers_of([beginning for beginning, _ in episodes], np.array(ids), which, state)
    return LabyrinthArrays(
        observations=looks.held() if hold else looks,
        initial=np.array(first),
        distance=np.array(distance),
        labyrinth_ids=np.array(ids, np.int64),
        routes=tuple(actions for _, actions in episodes),
        route_starts=starts,
        labyrinths=tuple(labyrinths),
        spec=spec,
        cells=labyrinths[0].structure.cells,
        **joined,
    )


def _joined(parts: Sequence[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Return the arrays of all parts, which are emptied."""
    return {name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])}


def _visitable(tables: Tables) -> list[int]:
    """Return the indices of the states that an episode can visit, in ascending order."""
    transitions, terminal = tables.transitions.tolist(), tables.terminal.tolist()
    reached, queue = {tables.initial}, [tables.initial]
    for state in queue:
        if not terminal[state]:
            new = set(transitions[state]) - reached
            reached |= new
            queue += new
    return sorted(reached)


def _columns(tables: Tables, cells: int, states: list[int], first: int) -> dict[str, NDArray[Any]]:
    """Return the arrays of one labyrinth, whose states are numbered from `first` on."""
    numbers = np.full(len(tables.terminal), -1)
    numbers[states] = np.arange(first, first + len(states))
    after, ends = tables.transitions[states], tables.terminal[states, None]
    return {
        "position": np.array(states) % cells,
        "terminal": ends[:, 0],
        "goal": tables.distances[states] == 0,
        "next_state": np.where(ends, numbers[states, None], numbers[after]),
        "rewards": np.where(ends, 0, tables.rewards[after]).astype(np.float32),
        "done": ends | tables.terminal[after],
        "optimal": tables.optimal_actions[states],
    }
