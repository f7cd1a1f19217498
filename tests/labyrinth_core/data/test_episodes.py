"""Episodes parsed, replayed and drawn together are those that are replayed and drawn one by one."""

from __future__ import annotations

import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.making import DemonstrationsConfig
from support.tampering import put_shards

from labyrinth_core import load_episodes, load_transitions, stream_episodes
from labyrinth_core.data import Dataset, Manifest
from labyrinth_core.language import describe, labyrinth_id, parse
from labyrinth_core.pictures import ObservationSpec, Painter
from labyrinth_core.world import Solver

BUILDS = {
    "navigation": {"size": "3x5", "shifts": ["recoloured", "thin_walls"]},
    "partial_observability": {"size": "4x3", "task": "partial_observability"},
    "key_and_door": {"size": "4x4", "task": "key_and_door", "solutions": "all"},
    "icy_floor": {"size": "4x5", "task": "icy_floor"},
    "noise": {"size": "4", "demonstrations": DemonstrationsConfig(noise=0.3)},
}


@pytest.fixture(scope="module", params=BUILDS)
def run(request, build, tmp_path_factory):
    return build(
        tmp_path_factory.mktemp("data"), labyrinths=5, random_steps=60, **BUILDS[request.param]
    )


def rows_by_episode(run, split):
    """Return the rows of each episode of a split, as its files hold them."""
    episodes = []
    for path in sorted(run.folder.glob(f"{split}-*-of-*.parquet")):
        for row in pq.read_table(path).to_pylist():
            if row["episode_starts"]:
                episodes.append([])
            episodes[-1].append(row)
    return episodes


TRANSITIONS = (
    *("observations", "next_observations", "actions", "rewards"),
    *("terminated", "truncated", "dones", "labyrinth_ids", "episode_indices", "rows"),
)
OBSERVED = {
    "decoded": ({"image_size": 9}, lambda *of: Painter(of[0]).array(of[1], 9)),
    "decoded in full": ({"image_size": 600}, lambda *of: Painter(of[0]).array(of[1])),
    "drawn": ({"image_size": 90, "draw": True}, lambda *of: Painter(of[0]).array(of[1], 90)),
    "drawn in full": ({"image_size": 600, "draw": True}, lambda *of: Painter(of[0]).array(of[1])),
    "vector": ({"observation": "vector"}, lambda *of: ObservationSpec("vector").look([of])[0]),
    "text": ({"observation": "text"}, describe),
}


@pytest.mark.slow
@pytest.mark.parametrize("observed", OBSERVED)
def test_all_that_is_loaded_is_what_the_rows_say_and_each_replayed_state_shows(run, observed):
    """Of episodes loaded and streamed, and of the transitions that are made of them."""
    options, observe = OBSERVED[observed]
    in_full = observed.endswith("in full")
    for split in ("train",) if in_full else Manifest.read(run.folder).config.splits:
        episodes = rows_by_episode(run, split)
        if in_full:
            options = options | {"labyrinths": 1}
            texts = [rows[0]["info"] for rows in episodes]
            episodes = episodes[: texts.count(texts[0])]
        place = run.data_dir, run.folder.name
        transitions = load_transitions(*place, split=split, **options, cache_dir=False)
        steps, first_row = [], 0
        both = (load(*place, split=split, **options) for load in (load_episodes, stream_episodes))
        for index, (rows, *ways) in enumerate(zip(episodes, *both, strict=True)):
            labyrinth = parse(rows[0]["info"])
            again = labyrinth.replay([row["actions"] for row in rows[:-1]])
            shown = np.array([observe(labyrinth, state) for state in again.states])
            number = int(labyrinth_id(labyrinth), 16)
            for episode in ways:
                np.testing.assert_array_equal(episode.observations, shown)
                np.testing.assert_array_equal(episode.actions, again.actions)
                np.testing.assert_array_equal(episode.rewards, again.rewards)
                assert (episode.observations.dtype, episode.rewards.dtype) == (shown.dtype, "f4")
                assert (len(episode), episode.info) == (len(rows) - 1, rows[0]["info"])
                assert (episode.terminated, episode.labyrinth_id) == (again.terminated, number)
                assert episode.truncated != episode.terminated
            for step, row in enumerate(rows[:-1]):
                last = step == len(rows) - 2
                ends = last and again.terminated, last and not again.terminated, last
                own = row["actions"], row["rewards"], *ends, number, index, first_row + step
                steps.append((shown[step], shown[step + 1], *own))
            first_row += len(rows)
        for name, values in zip(TRANSITIONS, zip(*steps, strict=True), strict=True):
            np.testing.assert_array_equal(getattr(transitions, name), np.array(values), name)


@pytest.mark.slow
def test_optimal_actions_are_those_of_each_state(run):
    for split in ("train", "random"):
        transitions = load_transitions(
            run.data_dir, run.folder.name, split=split, observation="vector", optimal=True
        )
        expected = []
        for block in Dataset.at(run.folder)[split].replayed():
            for which, state, acts in zip(block.which, block.states, block.acting, strict=True):
                if acts:
                    expected.append(Solver(block.parsed()[which]).optimal_actions()[state])
        np.testing.assert_array_equal(transitions.optimal, expected)


@pytest.mark.parametrize("cells", [1, 40])
def test_few_episodes_at_once_are_the_same_as_many(run, monkeypatch, cells):
    split = Dataset.at(run.folder)["random"]
    many = [one for block in split.replayed() for one in block.parts(1)]
    monkeypatch.setattr("labyrinth_core.data.load.PARSED_CELLS", cells)
    few = [one for block in split.replayed() for one in block.parts(9)]
    assert len(few) > 1
    for name in ("states", "over"):
        one, other = (np.concatenate([getattr(each, name) for each in of]) for of in (many, few))
        np.testing.assert_array_equal(one, other)
    ids = [np.concatenate([each.ids[each.which] for each in of]) for of in (many, few)]
    np.testing.assert_array_equal(*ids)


@pytest.mark.slow
def test_texts_that_are_not_canonical_are_read_too(run, tmp_path):
    """Such as those of another writer: they describe the same labyrinths, with other words."""
    folder = shutil.copytree(run.folder, tmp_path / run.folder.name)
    table = pa.concat_tables(map(pq.read_table, sorted(folder.glob("train-*.parquet"))))
    texts = [f'"""a comment"""\n{text}' for text in table["info"].to_pylist()]
    place = table.column_names.index("info")
    put_shards(folder, "train", [table.set_column(place, table.schema.field("info"), [texts])])
    options = {"draw": True, "image_size": 9, "cache_dir": False}
    theirs = load_transitions(tmp_path, folder.name, **options)
    ours = load_transitions(run.data_dir, folder.name, **options)
    for name in ("frames", "rows", "actions", "rewards", "terminated", "labyrinth_ids"):
        np.testing.assert_array_equal(getattr(theirs, name), getattr(ours, name))
    info = next(load_episodes(tmp_path, folder.name, observation="vector")).info
    assert info.startswith('"""a comment"""')
