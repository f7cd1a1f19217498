"""Hypothesis strategies: structures and labyrinths made without the library's sampler."""

from __future__ import annotations

from dataclasses import replace
from random import Random

from hypothesis import assume
from hypothesis import strategies as st

from labyrinth_core.world import Labyrinth, Structure, Task
from support.brute_force import (
    World,
    grid_passages,
    labyrinth_of,
    reachable,
    structure_with,
    unavoidable,
)

sides = st.integers(2, 5)
randoms = st.integers(0, 2**32 - 1).map(Random)


@st.composite
def structures(draw: st.DrawFn) -> Structure:
    """Any structure: every set of passages, connected or not."""
    height, width = draw(sides), draw(sides)
    passages = grid_passages(height, width)
    open_ones = draw(st.lists(st.booleans(), min_size=len(passages), max_size=len(passages)))
    chosen = [pair for pair, is_open in zip(passages, open_ones, strict=True) if is_open]
    return structure_with(height, width, chosen)


def connected_world(height: int, width: int, random: Random) -> World:
    """Return a world whose passages connect all places, with few or many more than needed."""
    passages = grid_passages(height, width)
    random.shuffle(passages)
    parts = {place: frozenset({place}) for pair in passages for place in pair}
    extra = random.choice([0.0, 0.1, 0.3, 0.7])
    chosen = set()
    for pair in passages:
        joined = frozenset().union(*(parts[place] for place in pair))
        if not joined <= parts[min(pair)] or random.random() < extra:
            chosen.add(pair)
        parts.update(dict.fromkeys(joined, joined))
    places = sorted(parts)
    start, goal = random.sample(places, 2)
    return World(height, width, frozenset(chosen), start, goal)


@st.composite
def connected_structures(draw: st.DrawFn) -> Structure:
    world = connected_world(draw(sides), draw(sides), draw(randoms))
    return structure_with(world.height, world.width, world.passages)


def with_key_and_door(world: World, random: Random) -> World | None:
    """Return the world with a door on every route and a key before it, if it can have them."""
    doors = sorted(unavoidable(world))
    random.shuffle(doors)
    for door in doors:
        before_the_door = reachable(world.passages, world.start, [door]) - {world.start}
        if before_the_door:
            return replace(world, key=random.choice(sorted(before_the_door)), door=door)
    return None


def with_ice(world: World, random: Random) -> World | None:
    """Return the world with ice anywhere but on one last way through, if it can have some."""
    free = sorted(set(world.places()) - {world.start, world.goal} - unavoidable(world))
    random.shuffle(free)
    ice: set[tuple[int, int]] = set()
    for place in free[: random.randint(1, len(free))] if free else ():
        if world.goal in reachable(world.passages, world.start, ice | {place}):
            ice.add(place)
    return replace(world, ice=frozenset(ice)) if ice else None


@st.composite
def labyrinths(draw: st.DrawFn, *tasks: Task) -> Labyrinth:
    """Labyrinths of the given tasks, or of all four; any start, any goal, tiles as they may be."""
    task = draw(st.sampled_from(tasks or list(Task)))
    random = draw(randoms)
    world: World | None = connected_world(draw(sides), draw(sides), random)
    if task is Task.KEY_AND_DOOR:
        world = with_key_and_door(world, random)
    elif task is Task.ICY_FLOOR:
        world = with_ice(world, random)
    assume(world is not None)
    return labyrinth_of(world, task)
