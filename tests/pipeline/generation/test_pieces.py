"""Routes in pieces: together they are what is handed out whole, and each replays by itself."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from brute_force import drawn, step
from tampering import TRAIN, Rows, episode_rows, episode_starts, problems, rows_of

from labyrinth_core import load_episodes, load_transitions, stream_episodes
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.labyrinth_table import TABLE
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.evaluation.baselines import TrainMemory, oracle_figures
from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
from labyrinth_core.language.text import dump, parse
from labyrinth_core.world.dynamics import State, initial
from labyrinth_core.world.labyrinth import Task
from labyrinth_core.world.solver import shortest_routes
from pipeline.config.dataset import DemonstrationsConfig
from pipeline.config.run import Run
from pipeline.inspection.statistics import count_dataset
from pipeline.release.provenance import command

pytestmark = pytest.mark.slow

Build = Callable[..., Run]

STEPS = 3
CASES: dict[str, dict[str, Any]] = {
    "navigation": {"shifts": ("g", "one_wall", "recoloured")},
    "partial_observability": {"task": Task.PARTIAL_OBSERVABILITY, "solutions": "all"},
    "key_and_door": {"task": Task.KEY_AND_DOOR, "noise": 0.3},
    "icy_floor": {"task": Task.ICY_FLOOR, "noise": 0.4, "labyrinths": 8},
    "loops": {"solutions": "all", "solutions_limit": 4, "open_walls": 0.5},
}


def built(build: Build, folder: Path, pieces: int, *, noise: float = 0, **options: Any) -> Run:
    small = {"size": "4", "labyrinths": 4, "random_steps": 10}
    demonstrations = DemonstrationsConfig(noise=noise, pieces=pieces)
    return build(folder, **small | options, demonstrations=demonstrations)


@pytest.fixture(scope="module", params=CASES)
def both(
    request: pytest.FixtureRequest, build: Build, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Run, Run]:
    """The same dataset with routes in pieces, and with whole routes."""
    folder, options = tmp_path_factory.mktemp("pieces"), CASES[request.param]
    whole, parts = (built(build, folder / str(n), n, **options) for n in (0, STEPS))
    return parts, whole


@pytest.fixture(scope="module")
def pieces(build: Build, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return built(build, tmp_path_factory.mktemp("pieces"), STEPS)


def test_a_dataset_in_pieces_is_valid(both: tuple[Run, Run]) -> None:
    parts, whole = both
    assert problems(parts.folder) == problems(whole.folder) == []
    random = [Manifest.read(run.folder).of("random")[0] for run in both]
    assert random[0] == random[1]


def test_the_transitions_are_those_of_whole_routes(both: tuple[Run, Run]) -> None:
    for split in both[0].dataset.splits:
        mine, its = (
            load_transitions(
                run.data_dir, run.dataset.name, split=split, image_size=8, optimal=True
            )
            for run in both
        )
        for name in (
            *("observations", "actions", "rewards", "next_observations"),
            *("terminated", "labyrinth_ids", "optimal"),
        ):
            assert np.array_equal(getattr(mine, name), getattr(its, name)), (split, name)


def test_each_piece_begins_where_the_one_before_it_was_cut(both: tuple[Run, Run]) -> None:
    """As the texts alone say it; nothing of the project's own code reads them."""
    parts, whole = both
    place = re.compile(r"^agent: \((\d), (\d)\)( with .*)?\n", re.MULTILINE)
    for split in parts.dataset.splits:
        (file,) = parts.folder.glob(f"{split}-*.parquet")
        rows = pq.read_table(file, columns=["actions", "episode_starts", "info"]).to_pylist()
        ends = [*episode_starts(rows)[1:], len(rows)]
        routes: list[list[int]] = []
        at = None
        for begin, end in zip(episode_starts(rows), ends, strict=True):
            info, actions = rows[begin]["info"], [row["actions"] for row in rows[begin : end - 1]]
            labyrinth, agent = drawn(place.sub("", info)), place.search(info)
            state = (labyrinth.start, False, False)
            if agent is not None:
                held = agent[3] or ""
                state = ((int(agent[1]), int(agent[2])), held != "", "door" in held)
                assert split != "random"
                assert state == at
                assert len(routes[-1]) % STEPS == 0
            else:  # A route, or a piece of one that has come back to the start.
                routes.append([])
            routes[-1] += actions
            for action in actions:
                state = step(labyrinth, state, action)[0]
            at = state
        of_whole = load_episodes(
            whole.data_dir, whole.dataset.name, split=split, observation="vector"
        )
        if split != "random":
            assert list(chain.from_iterable(routes)) == [
                action for each in of_whole for action in each.actions.tolist()
            ]


def test_a_budget_is_one_of_labyrinths_with_all_their_pieces(both: tuple[Run, Run]) -> None:
    parts, _ = both
    name = parts.dataset.name
    every = list(load_episodes(parts.data_dir, name, observation="vector"))
    ids = list(dict.fromkeys(each.labyrinth_id for each in every))
    assert len(ids) == parts.dataset.labyrinths < len(every)
    expected = [each.info for each in every if each.labyrinth_id in ids[:2]]
    for load in (load_episodes, stream_episodes):
        some = load(parts.data_dir, name, observation="vector", labyrinths=2)
        assert [each.info for each in some] == expected
    table = pq.read_table(parts.folder / TABLE).to_pylist()
    least = sorted(row["moves"] for row in table if row["split"] == "train")[-1]
    where = pc.field("moves") >= least
    filtered = load_episodes(parts.data_dir, name, observation="vector", where=where)
    longest = {int(r["labyrinth_id"], 16) for r in table if r["moves"] >= least}
    assert {each.labyrinth_id for each in filtered} == longest & set(ids)


def test_the_table_differs_in_episodes_and_rows_alone(both: tuple[Run, Run]) -> None:
    parts, _ = both
    mine, its = (pq.read_table(run.folder / TABLE) for run in both)
    counted = ["episodes", "rows", "first_row"]
    assert mine.drop_columns(counted).equals(its.drop_columns(counted))
    for split in parts.dataset.splits:
        (file,) = parts.folder.glob(f"{split}-*.parquet")
        rows = pq.read_table(file, columns=["episode_starts", "info"]).to_pylist()
        of_split = mine.filter(pc.field("split") == split).to_pylist()
        for row in of_split:
            own = rows[row["first_row"] : row["first_row"] + row["rows"]]
            assert sum(each["episode_starts"] for each in own) == row["episodes"]
            assert len({re.sub("agent.*\n", "", each["info"]) for each in own}) == 1
        assert sum(row["rows"] for row in of_split) == len(rows)


def test_counts_and_arrays_are_of_labyrinths_from_their_start(both: tuple[Run, Run]) -> None:
    mine, its = (count_dataset(run.folder, Manifest.read(run.folder)) for run in both)
    assert mine.certificate == its.certificate
    for split, counts in mine.splits.items():
        assert counts.moves == its.splits[split].moves
        assert (counts.optimal, counts.choices) == (
            its.splits[split].optimal,
            its.splits[split].choices,
        )
    a, b = (
        load_arrays(run.data_dir, run.dataset.name, "train", observation="vector") for run in both
    )
    assert a.labyrinths == b.labyrinths
    for name in ("observations", "initial", "distance", "demonstrated", "labyrinth_ids"):
        assert np.array_equal(getattr(a, name), getattr(b, name))
    assert all(len(route) <= STEPS for route in a.routes)
    blind = [TrainMemory.of(each).blind_figures(each) for each in (a, b)]
    assert {*blind[0]} == {*blind[1]}
    assert oracle_figures(a) == oracle_figures(b)


def test_pieces_as_long_as_any_route_are_whole_routes(build: Build, tmp_path: Path) -> None:
    whole, long = (built(build, tmp_path / str(n), n, labyrinths=2) for n in (0, 100))
    shards = [Manifest.read(run.folder).shards for run in (whole, long)]
    assert shards[0] == shards[1]
    assert "pieces" not in (whole.folder / "manifest.json").read_text()
    assert command(long.dataset).endswith(" demonstrations.pieces=100")


def with_agent(info: str, move: int) -> str:
    """Return a text in which the agent begins some cells farther."""
    labyrinth = parse(info)
    cell = (initial(labyrinth).agent + move) % labyrinth.structure.cells
    return dump(replace(labyrinth, agent=initial(labyrinth)._replace(agent=cell)))


def elsewhere(rows: Rows, second: range) -> str:
    """Let the second piece begin a cell away from where the first was cut."""
    info = with_agent(rows[second[0]]["info"], 1)
    for row in second:
        rows[row]["info"] = info
    return f"{TRAIN} row {second[0]} info: the agent begins in "


def on_the_start(rows: Rows, second: range) -> str:
    """Let the second piece begin as an episode without pieces does."""
    for row in second:
        rows[row]["info"] = rows[0]["info"]
    return f"{TRAIN} row {second[0]} info: the agent begins in (0, 0), not in "


def in_no_order(rows: Rows, second: range) -> str:
    """Let the text of the second piece have its settings in another order."""
    head, agent, rest = re.split("(agent: .*\n)", rows[second[0]]["info"], maxsplit=1)
    for row in second:
        rows[row]["info"] = head.replace("icy", f"{agent}icy") + rest
    return f"{TRAIN} row {second[0]} info: not in the canonical form"


def of_no_cell(rows: Rows, second: range) -> str:
    """Let the text of the second piece name a cell outside the labyrinth."""
    for row in second:
        rows[row]["info"] = re.sub("agent: .*\n", "agent: (9, 9)\n", rows[row]["info"])
    return f"{TRAIN} row {second[0]} info: not a labyrinth: "


def left_out(rows: Rows, second: range) -> str:
    """Leave the second piece out, so that the first and the third do not join."""
    del rows[second[0] : second[-1] + 1]
    return f"{TRAIN} row {second[0]} info: the agent begins in "


def without_an_end(rows: Rows, _: range) -> str:
    """Leave out the last piece of the first labyrinth."""
    of_first = re.sub("agent.*\n", "", rows[0]["info"])
    own = [re.sub("agent.*\n", "", row["info"]) == of_first for row in rows]
    starts = [start for start in episode_starts(rows) if own[start]]
    del rows[starts[-1] : sum(own)]
    return f"{TRAIN} row 0 actions: routes of "


def joined(rows: Rows, second: range) -> str:
    """Make one piece of the first and the second."""
    begin = second[0]
    del rows[begin - 1]
    rows[begin - 1]["episode_starts"] = False
    for place, row in enumerate(rows[: second[-1]]):
        row["info"] = rows[0]["info"]
        row["obs"]["path"] = f"train-000000-000-{place:04d}.png"
    return f"{TRAIN} row 0 actions: a route in pieces of {begin - 1 + len(second) - 1}, "


@pytest.mark.parametrize(
    "change", [elsewhere, on_the_start, in_no_order, of_no_cell, left_out, without_an_end, joined]
)
def test_pieces_that_do_not_make_the_route_are_found(
    pieces: Run, tmp_path: Path, change: Callable[[Rows, range], str]
) -> None:
    folder = tmp_path / "changed"
    shutil.copytree(pieces.folder, folder)
    with rows_of(folder) as rows:
        _, second, third, *_ = episode_starts(rows)
        begins = change(rows, range(second, third))
    found = problems(folder)
    assert any(problem.startswith(begins) for problem in found), found


def test_an_agent_that_begins_elsewhere_is_found_where_routes_are_whole(
    build: Build, tmp_path: Path
) -> None:
    run = built(build, tmp_path, 0, labyrinths=2)
    with rows_of(run.folder) as rows:
        first = rows[0]["info"]
        for row in [row for row in rows if row["info"] == first]:
            row["info"] = with_agent(first, 1)
    found = problems(run.folder)
    assert f"{TRAIN} row 0 info: the agent begins in (0, 1), not in (0, 0)" in found


def test_an_episode_that_begins_where_no_way_leads_is_refused(build: Build, tmp_path: Path) -> None:
    """Behind the closed door without the key: near the goal, and no agent comes there."""
    run = built(build, tmp_path, STEPS, task=Task.KEY_AND_DOOR)
    with rows_of(run.folder) as rows:
        first = parse(rows[0]["info"])
        behind = first.structure.distances(first.goal, [first.door]).index(1)
        begun = replace(first, agent=State(behind))
        (way,) = shortest_routes(begun)
        rows[: episode_starts(rows)[1]] = episode_rows("train", 0, begun, way)
    with pytest.raises(DatasetError, match="an episode begins off all ways of the agent"):
        load_arrays(run.data_dir, run.dataset.name, "train", observation="vector")
