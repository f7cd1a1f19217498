"""The rules of the world, written a second time, slowly and plainly, to check the library against.

Nothing in here calls the library's rules. Places are `(row, column)`, passages are pairs of
places, and everything is dictionaries and sets. The pictures are those of the text language,
read by a few lines that know no errors; `shown` reads the labyrinths of a split so.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import combinations, groupby
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from labyrinth_core.world import Labyrinth, Structure, Task

Place = tuple[int, int]
Passages = frozenset[frozenset[Place]]
Situation = tuple[Place, bool, bool]
"""Where the agent is, whether it has the key, whether the door is open."""

WAYS: dict[int, Place] = {0: (1, 0), 1: (0, 1), 2: (-1, 0), 3: (0, -1)}
"""Action -> rows and columns further."""


@dataclass(frozen=True)
class World:
    """A labyrinth without the library."""

    height: int
    width: int
    passages: Passages
    start: Place
    goal: Place
    key: Place | None = None
    door: Place | None = None
    ice: frozenset[Place] = frozenset()

    def places(self) -> list[Place]:
        return [(row, column) for row in range(self.height) for column in range(self.width)]


# The library's objects, there and back.


def grid_passages(height: int, width: int) -> list[frozenset[Place]]:
    """Return the places of a grid that lie side by side, row by row."""
    return [
        frozenset({(row, column), beside})
        for row in range(height)
        for column in range(width)
        for beside in ((row + 1, column), (row, column + 1))
        if beside[0] < height and beside[1] < width
    ]


def passages_of(structure: Structure) -> Passages:
    """Return the passages of a structure, from the bits that define it."""
    found = set()
    for row in range(structure.height):
        for column in range(structure.width):
            cell = row * structure.width + column
            if structure.up >> cell & 1:
                found.add(frozenset({(row, column), (row + 1, column)}))
            if structure.right >> cell & 1:
                found.add(frozenset({(row, column), (row, column + 1)}))
    return frozenset(found)


def structure_with(height: int, width: int, passages: Collection[frozenset[Place]]) -> Structure:
    """Return the structure with these passages, its bits set one by one."""
    up = right = 0
    for (row, column), (row_beyond, _) in map(sorted, passages):
        bit = 1 << row * width + column
        if row_beyond > row:
            up |= bit
        else:
            right |= bit
    return Structure(height, width, up, right)


def all_structures(height: int, width: int) -> Iterator[Structure]:
    """Yield the structure of every set of passages, connected or not."""
    everything = grid_passages(height, width)
    for count in range(len(everything) + 1):
        for passages in combinations(everything, count):
            yield structure_with(height, width, passages)


def world_of(labyrinth: Labyrinth) -> World:
    structure = labyrinth.structure

    def place(cell: int) -> Place:
        return cell // structure.width, cell % structure.width

    return World(
        structure.height,
        structure.width,
        passages_of(structure),
        place(labyrinth.start),
        place(labyrinth.goal),
        None if labyrinth.key is None else place(labyrinth.key),
        None if labyrinth.door is None else place(labyrinth.door),
        frozenset(place(cell) for cell in labyrinth.ice),
    )


def labyrinth_of(world: World, task: Task = Task.NAVIGATION) -> Labyrinth:
    """Return the labyrinth of a world; an error if the library refuses it."""

    def cell(place: Place | None) -> int | None:
        return None if place is None else place[0] * world.width + place[1]

    return Labyrinth(
        structure_with(world.height, world.width, world.passages),
        cell(world.start),
        cell(world.goal),
        task,
        key=cell(world.key),
        door=cell(world.door),
        ice=frozenset(cell(place) for place in world.ice),
    )


def drawn(text: str) -> World:
    """Return the world of a drawing, or of the one in a text of the language.

    Without `S` and `E` they lie in the default corners.
    """
    picture = (text.partition("labyrinth:")[2] or text).strip().removesuffix("end")
    lines = [line.strip() for line in picture.strip().splitlines()][1:-1][::-1]
    height, width = len(lines) // 2 + 1, len(lines[0]) // 4
    tiles: dict[str, set[Place]] = {letter: set() for letter in " SEKDI"}
    passages = set()
    for row in range(height):
        for column in range(width):
            tiles[lines[2 * row][4 * column + 2]].add((row, column))
            if column + 1 < width and lines[2 * row][4 * column + 4] == " ":
                passages.add(frozenset({(row, column), (row, column + 1)}))
            if row + 1 < height and lines[2 * row + 1][4 * column + 2] == " ":
                passages.add(frozenset({(row, column), (row + 1, column)}))
    corners = {"S": (0, 0), "E": (height - 1, width - 1)}
    one = {letter: next(iter(tiles[letter]), corners.get(letter)) for letter in "SEKD"}
    return World(
        height,
        width,
        frozenset(passages),
        one["S"],
        one["E"],
        one["K"],
        one["D"],
        frozenset(tiles["I"]),
    )


# What can be reached.


def reachable(
    passages: Collection[frozenset[Place]], origin: Place, without: Collection[Place] = ()
) -> set[Place]:
    """Return the places that passages join to the origin, none of them in `without`."""
    found, changed = {origin}, True
    while changed:
        onward = {
            place
            for pair in passages
            if pair & found
            for place in pair - found
            if place not in without
        }
        found |= onward
        changed = bool(onward)
    return found


def loops(world: World) -> int:
    """Return how many passages are open beyond the fewest that connect all places."""
    return len(world.passages) - world.height * world.width + 1


def is_connected(height: int, width: int, passages: Passages) -> bool:
    return len(reachable(passages, (0, 0))) == height * width


def unavoidable(world: World) -> set[Place]:
    """Return the places without which the goal cannot be reached, other than start and goal."""
    return {
        place
        for place in set(world.places()) - {world.start, world.goal}
        if world.goal not in reachable(world.passages, world.start, [place])
    }


def keeps_the_rules(world: World, task: Task) -> bool:
    """Return whether the tiles are the task's, lie apart in the grid, and leave a way through."""
    given = {"key": world.key is not None, "door": world.door is not None, "ice": bool(world.ice)}
    needed = {Task.KEY_AND_DOOR: {"key", "door"}, Task.ICY_FLOOR: {"ice"}}.get(task, set())
    if {tile for tile in given if given[tile]} != needed:
        return False
    tiles = [world.start, world.goal, *world.ice]
    tiles += [tile for tile in (world.key, world.door) if tile is not None]
    if len(set(tiles)) < len(tiles) or not set(tiles) <= set(world.places()):
        return False
    if world.goal not in reachable(world.passages, world.start, world.ice):
        return False
    if task is Task.KEY_AND_DOOR:
        before_the_door = reachable(world.passages, world.start, [world.door])
        return world.goal not in before_the_door and world.key in before_the_door
    return True


# What a step does.


def step(world: World, situation: Situation, action: int) -> tuple[Situation, float, bool]:
    """Return the next situation, the reward, and whether the episode is over."""
    place, has_key, door_open = situation
    ahead = (place[0] + WAYS[action][0], place[1] + WAYS[action][1])
    passable = frozenset({place, ahead}) in world.passages
    if passable and ahead == world.door and not has_key:
        passable = False
    if passable:
        place = ahead
        has_key = has_key or place == world.key
        door_open = door_open or place == world.door
        if place in world.ice:
            return (place, has_key, door_open), -100.0, True
        if place == world.goal:
            return (place, has_key, door_open), 1.0, True
    return (place, has_key, door_open), -0.1 / (world.width * world.height), False


def walk(world: World, actions: Collection[int]) -> Place:
    """Return where actions lead, bumping into walls and going on over ice."""
    situation = (world.start, False, False)
    for action in actions:
        situation = step(world, situation, action)[0]
    return situation[0]


def situations(world: World) -> list[Situation]:
    """Return every situation that the rules allow, also those that no route leads to."""
    phases = (
        [(False, False)] if world.door is None else [(False, False), (True, False), (True, True)]
    )
    return [
        (place, has_key, door_open)
        for has_key, door_open in phases
        for place in world.places()
        if (door_open or place != world.door) and (has_key or place != world.key)
    ]


def is_over(world: World, situation: Situation) -> bool:
    return situation[0] == world.goal or situation[0] in world.ice


# Optimal behaviour.


def moves_to_go(world: World) -> dict[Situation, int]:
    """Return the least number of moves to the goal from each situation that has a way there."""
    before: dict[Situation, set[Situation]] = {}
    for situation in situations(world):
        if not is_over(world, situation):
            for action in WAYS:
                before.setdefault(step(world, situation, action)[0], set()).add(situation)
    layer = {situation for situation in situations(world) if situation[0] == world.goal}
    moves = dict.fromkeys(layer, 0)
    while layer:
        layer = {earlier for later in layer for earlier in before.get(later, ())} - moves.keys()
        moves.update(dict.fromkeys(layer, max(moves.values()) + 1))
    return moves


def fewest_moves(world: World) -> int | None:
    """Return the moves of a shortest route, None if none leads to the goal."""
    return moves_to_go(world).get((world.start, False, False))


def best_actions(world: World) -> dict[Situation, set[int]]:
    """Return which actions begin a shortest route; none where the episode is over or lost."""
    moves = moves_to_go(world)
    best = {}
    for situation in situations(world):
        after = {
            action: moves[step(world, situation, action)[0]] + 1
            for action in WAYS
            if not is_over(world, situation) and step(world, situation, action)[0] in moves
        }
        best[situation] = {
            action for action, total in after.items() if total == moves.get(situation)
        }
    return best


def simple_routes(world: World) -> list[tuple[int, ...]]:
    """Return the actions of every route from start to goal that repeats no situation."""

    def onward(situation: Situation, visited: frozenset[Situation]) -> Iterator[tuple[int, ...]]:
        if situation[0] == world.goal:
            yield ()
            return
        for action in WAYS:
            after, _, over = step(world, situation, action)
            if after not in visited and (not over or after[0] == world.goal):
                for rest in onward(after, visited | {after}):
                    yield (action, *rest)

    first = (world.start, False, False)
    return list(onward(first, frozenset({first})))


def shortest_of(routes: list[tuple[int, ...]]) -> list[tuple[int, ...]]:
    least = min(map(len, routes))
    return [route for route in routes if len(route) == least]


# What the agent sees.


def sees(passages: Passages, place: Place, target: Place) -> bool:
    """Return whether a straight or exactly diagonal line of sight is unbroken."""
    rows, columns = target[0] - place[0], target[1] - place[1]
    if rows and columns and abs(rows) != abs(columns):
        return False
    up = (rows > 0) - (rows < 0)
    aside = (columns > 0) - (columns < 0)
    for far in range(max(abs(rows), abs(columns))):
        here = (place[0] + up * far, place[1] + aside * far)
        corner = (here[0], here[1] + aside)
        there = (here[0] + up, here[1] + aside)
        for pair in ({here, corner}, {corner, there}):
            if len(pair) == 2 and frozenset(pair) not in passages:
                return False
    return True


# How likely an outcome is.


def chi_square(observed: Collection[int], expected: Collection[float]) -> float:
    """Return the chi-square statistic, in standard deviations above what chance makes of it."""
    pairs = list(zip(observed, expected, strict=True))
    statistic = sum((count - hoped) ** 2 / hoped for count, hoped in pairs)
    freedom = len(pairs) - 1
    return (statistic - freedom) / (2 * freedom) ** 0.5


@dataclass(frozen=True)
class Shown:
    """A labyrinth of a split, as its rows show it."""

    number: int
    """The number in the names of its pictures."""
    text: str
    settings: str
    """The part of the text before the drawing."""
    labyrinth: World
    actions: list[int]
    """Of its first episode."""
    pictures: list[bytes]
    """Of its first episode."""


def shown(folder: Path, split: str) -> list[Shown]:
    """Return the labyrinths of a split, in order."""
    rows: list[dict[str, Any]] = []
    for path in sorted(folder.glob(f"{split}-*-of-*.parquet")):
        rows += pq.read_table(path).to_pylist()
    found = []
    for text, group in groupby(rows, key=lambda row: row["info"]):
        of = list(group)
        starts = [place for place, row in enumerate(of) if row["episode_starts"]]
        first = of[: [*starts, len(of)][1]]
        found.append(
            Shown(
                int(first[0]["obs"]["path"].split("-")[1]),
                text,
                text.partition("labyrinth:")[0],
                drawn(text),
                [row["actions"] for row in first[:-1]],
                [row["obs"]["bytes"] for row in first],
            )
        )
    return found
