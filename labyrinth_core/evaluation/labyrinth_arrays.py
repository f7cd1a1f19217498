"""The labyrinths of a split as arrays, indexed by the states of all labyrinths.

Evaluation, labelling and rollouts become look-ups, without the environment. The arrays are computed
from the column `info` and the actions; pictures are drawn, and equal those in `obs`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.dataset import Filter, Query, Source, derived_from
from labyrinth_core.data.episodes import LoadedEpisode, replayed
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.observations import Looks, ObservationSpec
from labyrinth_core.data.splits import BASE_SPLITS, is_of_train
from labyrinth_core.language.text import labyrinth_id, parse
from labyrinth_core.pictures.png import DEFAULT_IMAGE_SIZE
from labyrinth_core.world.batch import Tables, tabulate
from labyrinth_core.world.dynamics import STEP_LIMIT, State, initial, state_at, state_index
from labyrinth_core.world.labyrinth import Labyrinth

Place = tuple[int, int]
"""The id of a labyrinth, and the index of a state in it as in `dynamics.state_index`."""


@dataclass(frozen=True, eq=False)
class LabyrinthArrays:
    """L labyrinths of one size and task, and the S states that episodes in them can visit.

    States that no episode reaches are left out: those behind the goal or ice, and those on a
    closed door. Goal and ice are terminal states: every action in them leads back to them with
    reward 0 and ends the episode, so that look-ups need no special case.
    """

    observations: NDArray[Any] | Looks
    """The observation of each state: uint8 (S, size, size, 3), int32 vectors (S, length), or texts
    (S,). More than 1 GiB of pictures is not held, but drawn whenever states are indexed."""
    labyrinth: NDArray[np.int64]
    """The index of the state's labyrinth, from 0 to L - 1, ascending, shape (S,)."""
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
    demonstrated: NDArray[np.int64]
    """How often the episodes of the dataset take each action, shape (S, 4)."""
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
    places: Mapping[Place, int]
    """The index of the state in each place, in ascending order."""

    @property
    def on_demonstration(self) -> NDArray[np.bool_]:
        """Whether an episode of the dataset acts in the state, shape (S,)."""
        on: NDArray[np.bool_] = self.demonstrated.sum(axis=1) > 0
        return on

    @property
    def step_limit(self) -> int:
        """The number of steps after which an episode is cut."""
        return STEP_LIMIT * self.cells


def first_place(episode: LoadedEpisode) -> Place:
    """Return the place in which an episode of a dataset begins."""
    labyrinth = parse(episode.info)
    return episode.labyrinth_id, state_index(labyrinth, initial(labyrinth))


def number_of(place: Place, places: Mapping[Place, int]) -> int:
    """Return the index of the state in a place.

    Raises:
        DatasetError: The place cannot be reached from the start.
    """
    if place not in places:
        raise DatasetError(
            f"labyrinth {place[0]:016x}: an episode begins where the agent cannot get"
        )
    return places[place]


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
    where: Filter | None = None,
) -> LabyrinthArrays:
    """Return the labyrinths of a split as arrays.

    Args:
        source: Folder with the dataset, or its id on the Hub such as `user/labyrinth`.
        config: Name of the dataset's config, such as `5x5` or `5x5-key_and_door`.
        split: Name of the split, such as `train`.
        observation: "image", "vector" or "text".
        image_size: Pixels on each side of the pictures.
        resize: How pictures are made smaller; one of `labyrinth_core.data.observations.RESIZES`.
        revision: Branch, tag or commit on the Hub; not for folders.
        labyrinths: Number of labyrinths, the first ones; see `load_episodes`, also for `where`.
        where: A filter of the table of labyrinths.

    Raises:
        ValueError: An argument has a value that is not allowed.
        DatasetError: The dataset or split does not exist, or its rows do not form episodes.
    """
    spec = ObservationSpec(observation, image_size, draw=True, resize=resize)
    query = Query(Source(source, config, revision), split).filter(where, labyrinths=labyrinths)
    return arrays_in(query, spec)


def arrays_in(query: Query, spec: ObservationSpec) -> LabyrinthArrays:
    """Return the labyrinths that a query requests as arrays; see `load_arrays`."""
    held: dict[int, Labyrinth] = {}
    episodes: list[tuple[Place, NDArray[np.int64]]] = []
    part = query.part()
    for block in replayed(part.rows(pictures=False), part.config):
        ids, (rows, firsts, lasts) = block.ids.tolist(), block.whole
        for number, labyrinth in zip(ids, block.parsed(), strict=True):
            held.setdefault(number, labyrinth)
        for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
            place = ids[block.which[first]], int(block.states[first])
            episodes.append((place, rows.actions[first:last].copy()))
    if not held:
        raise DatasetError(f"split={query.split} has no episodes")
    return _stack(list(held.values()), list(held), episodes, spec, spec.look_later)


def of_the_learnt(
    source: str | Path, config: str, split: str, learnt: int | None, revision: str | None = None
) -> dict[str, Any]:
    """Return the arguments of `load_arrays` for the labyrinths derived from the first of train.

    `learnt` is the number of these, None for all. Splits that are not derived from train
    (`is_of_train`) are whole in any case. Raises the errors of `load_arrays`.
    """
    if learnt is None or not is_of_train(split):
        return {}
    if split in BASE_SPLITS:  # One labyrinth for each of train.
        return {"labyrinths": learnt}
    options: dict[str, Any] = {"revision": revision, "labyrinths": learnt}
    train = load_arrays(source, config, "train", observation="vector", **options)
    return {"where": derived_from(train.labyrinth_ids)}


def as_arrays(labyrinths: Sequence[Labyrinth], spec: ObservationSpec) -> LabyrinthArrays:
    """Return labyrinths of one size and task as arrays, without demonstrations.

    States are observed when they are indexed, since a policy sees few of those of large labyrinths.
    """
    ids = [int(labyrinth_id(each), 16) for each in labyrinths]
    return _stack(labyrinths, ids, [], spec, lambda views: Looks(spec, views))


def _stack(
    labyrinths: Sequence[Labyrinth],
    ids: Sequence[int],
    episodes: Sequence[tuple[Place, NDArray[np.int64]]],
    spec: ObservationSpec,
    observe: Callable[[Sequence[tuple[Labyrinth, State]]], NDArray[Any] | Looks],
) -> LabyrinthArrays:
    tables = [tabulate(each) for each in labyrinths]
    parts: list[dict[str, NDArray[Any]]] = []
    places: dict[Place, int] = {}
    views: list[tuple[Labyrinth, State]] = []
    first: list[int] = []
    for number, labyrinth, each in zip(ids, labyrinths, tables, strict=True):
        states, count = _visitable(each), len(views)
        places |= {(number, state): count + place for place, state in enumerate(states)}
        views += [(labyrinth, state_at(labyrinth, state)) for state in states]
        first.append(count + states.index(each.initial))
        part = _columns(each, labyrinth.structure.cells, states, count)
        parts.append(part | {"labyrinth": np.full(len(states), len(parts))})
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    after, demonstrated = joined["next_state"].tolist(), np.zeros((len(views), 4), np.int64)
    starts = [number_of(place, places) for place, _ in episodes]
    for state, (_, actions) in zip(starts, episodes, strict=True):
        for action in actions.tolist():
            demonstrated[state, action] += 1
            state = after[state][action]
    return LabyrinthArrays(
        observations=observe(views),
        demonstrated=demonstrated,
        initial=np.array(first),
        distance=np.array([each.distances[each.initial] for each in tables]),
        labyrinth_ids=np.array(ids, np.int64),
        routes=tuple(actions for _, actions in episodes),
        route_starts=np.array(starts, np.int64),
        labyrinths=tuple(labyrinths),
        spec=spec,
        cells=labyrinths[0].structure.cells,
        places=places,
        **joined,
    )


def _visitable(tables: Tables) -> list[int]:
    """Return the indices of the states that an episode can visit, in ascending order."""
    transitions, terminal = tables.transitions.tolist(), tables.terminal.tolist()
    found, queue = {tables.initial}, [tables.initial]
    for state in queue:
        if not terminal[state]:
            new = set(transitions[state]) - found
            found |= new
            queue += new
    return sorted(found)


def _columns(tables: Tables, cells: int, states: list[int], first: int) -> dict[str, NDArray[Any]]:
    """Return the arrays of one labyrinth, whose states are numbered from `first` on."""
    place = np.full(len(tables.terminal), -1)
    place[states] = np.arange(first, first + len(states))
    after, ends = tables.transitions[states], tables.terminal[states, None]
    return {
        "position": np.array(states) % cells,
        "terminal": ends[:, 0],
        "goal": tables.distances[states] == 0,
        "next_state": np.where(ends, place[states, None], place[after]),
        "rewards": np.where(ends, 0, tables.rewards[after]).astype(np.float32),
        "done": ends | tables.terminal[after],
        "optimal": tables.optimal_actions[states],
    }
