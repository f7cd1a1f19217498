"""The table of labyrinths says what the rows of the shards say, counted here in another way."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import groupby, pairwise
from math import comb, inf
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from datasets import load_dataset
from support.brute_force import (
    World,
    moves_to_go,
    passages_of,
    shortest_of,
    simple_routes,
    step,
    world_of,
)
from support.making import Run
from support.tampering import Rows, read_rows

from labyrinth_core.data import SPLITS, TABLE_COLUMNS, Manifest
from labyrinth_core.language import dump, labyrinth_id, parse
from labyrinth_core.world import Labyrinth, Solver, Structure
from pipeline.generation import table
from pipeline.generation.labyrinths import Solution

pytestmark = pytest.mark.slow

Build = Callable[..., Run]
CONFIGS = ["3x4", "3x4-partial_observability", "3x4-key_and_door", "3x4-icy_floor"]


def table_of(folder: Path) -> Rows:
    return list(pq.read_table(folder / Manifest.TABLE).to_pylist())


def expected_table(folder: Path) -> Rows:
    """Return the rows of the table, from the rows of the shards alone."""
    table: Rows = []
    manifest = Manifest.read(folder)
    train: dict[str, str] = {}
    for split in SPLITS.base:
        rows = [row for shard in manifest.of(split) for row in read_rows(folder / shard.path)]
        first = 0
        for info, grouped in groupby(rows, lambda row: str(row["info"])):
            own = list(grouped)
            found = expected_row(info, own) | {"split": split, "first_row": first}
            if split == "train":
                train[found["structure_id"]] = found["labyrinth_id"]
            found["parent_id"] = None if split in SPLITS.sampled else train[found["structure_id"]]
            found["turns"] = None if split == "random" else found["turns"]
            table.append(found)
            first += len(own)
    return table


def optimal_actions_in(world: World, rows: Rows) -> int:
    """Return how many actions lead a move nearer to the goal."""
    to_go, count = moves_to_go(world), 0
    situation = (world.start, False, False)
    for row in rows:
        if row["episode_starts"]:
            situation = (world.start, False, False)
        if row["actions"] >= 0:
            after, _, _ = step(world, situation, row["actions"])
            count += to_go.get(after, inf) == to_go[situation] - 1
            situation = after
    return count


def expected_row(info: str, rows: Rows) -> dict[str, Any]:
    labyrinth = parse(info)
    world, structure = world_of(labyrinth), labyrinth.structure
    degree = Counter(place for pair in passages_of(structure) for place in pair)
    ends = [n for n, row in enumerate(rows) if row["actions"] == -1]
    first = [row["actions"] for row in rows[: ends[0]]]
    return {
        "labyrinth_id": labyrinth_id(labyrinth),
        "structure_id": structure.structure_id,
        "height": 3,
        "width": 4,
        "task": str(labyrinth.task),
        "start": world.start[0] * 4 + world.start[1],
        "goal": world.goal[0] * 4 + world.goal[1],
        "moves": moves_to_go(world)[world.start, False, False],
        "optimal_routes": len(shortest_of(simple_routes(world))),
        "turns": sum(one != other for one, other in pairwise(first)),
        "loops": len(passages_of(structure)) - 12 + 1,
        "branching": sum(ways >= 3 for ways in degree.values()),
        "dead_ends": sum(ways == 1 for ways in degree.values()),
        "episodes": len(ends),
        "rows": len(rows),
        "optimal_actions": optimal_actions_in(world, rows),
    }


@pytest.mark.parametrize("config", CONFIGS)
def test_every_row_is_what_the_shards_say(datasets: Path, config: str) -> None:
    folder = datasets / config
    found = table_of(folder)
    assert found == expected_table(folder)
    assert len(found) == 5 * len(SPLITS.base)
    assert [*found[0]] == [column.name for column in TABLE_COLUMNS]


def test_routes_more_than_fit_are_as_many_as_fit(small_dataset: Run) -> None:
    labyrinth = Labyrinth(Structure.without_walls(40, 40), 0, 1599)
    moves, routes = Solver(labyrinth).moves_and_routes()
    assert (moves, routes) == (78, comb(78, 39))
    content = table.Content(small_dataset.dataset, "train")
    episode = labyrinth.replay([0] * 39 + [1] * 39)
    content.add(dump(labyrinth), Solution([episode], (moves, routes)), None)
    (fact,) = content.facts()
    assert fact["optimal_routes"] == table.MOST_ROUTES
    assert (fact["turns"], fact["loops"], fact["dead_ends"]) == (1, 39 * 39, 0)


def test_shards_and_row_groups_may_end_anywhere(
    build: Build, tmp_path: Path, small_dataset: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = build(tmp_path, cells_per_shard=3 * 9).folder
    assert table_of(folder) == table_of(small_dataset.folder)
    manifest = Manifest.read(folder)
    parts, first = [], 0
    for shard in manifest.shards:
        parts.append((shard, table.table_facts(folder, first, shard.labyrinths)))
        first += shard.labyrinths
    path = tmp_path / "table.parquet"
    monkeypatch.setattr(table, "GROUP_ROWS", 5)
    table.write_table(path, manifest.config, parts)
    assert pq.read_table(path).equals(pq.read_table(folder / Manifest.TABLE))
    with pq.ParquetFile(path) as file:
        sizes = [file.metadata.row_group(n).num_rows for n in range(file.num_row_groups)]
    assert sizes == [6, 5, 5] * 3


def test_datasets_reads_it_as_a_config_of_its_own(small_dataset: Run) -> None:
    loaded = load_dataset(str(small_dataset.data_dir), "3x3-labyrinths", split="labyrinths")
    assert list(loaded) == table_of(small_dataset.folder)
    assert list(loaded.features) == [column.name for column in TABLE_COLUMNS]
