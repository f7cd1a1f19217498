"""The statistics and the certificate, against counting by hand."""

from __future__ import annotations

from collections import Counter
from itertools import combinations

import numpy as np
import pyarrow.parquet as pq
import pytest
from planting import DEFAULT, OTHER, labyrinths, plant, rows, shard, transposed, write

from labyrinth_core.data.columns import SAMPLED_SPLITS, SPLITS
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.language.text import dump, parse
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.rollout import replay
from labyrinth_core.world.solver import distances
from pipeline.generation import build
from pipeline.release.statistics import measure


def measured(folder):
    return measure(folder, Manifest.read(folder))


def episodes(folder, split):
    """Return the labyrinth and the replay of each episode of a split."""
    found = []
    for row in rows(folder, split):
        if row["episode_starts"]:
            found.append((row["info"], []))
        found[-1][1].append(row)
    return [
        (parse(info), replay(parse(info), [row["actions"] for row in of[:-1]]), of)
        for info, of in found
    ]


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("name", [DEFAULT, OTHER])
def test_every_number_is_what_replaying_the_rows_gives(carded, name, split):
    folder = carded / name
    counted = measured(folder).of(split)
    replayed = episodes(folder, split)
    visits = np.zeros(counted.visits.shape, int)
    actions, choices, optimal = Counter(), [], []
    for labyrinth, episode, _ in replayed:
        for state in episode.states:
            visits[divmod(state.agent, labyrinth.structure.width)] += 1
        actions.update(episode.actions.tolist())
    assert counted.split == split
    assert counted.labyrinths == len(labyrinths(folder, split))
    assert counted.episodes == len(replayed)
    assert counted.rows == len(rows(folder, split)) == visits.sum()
    assert (counted.visits == visits).all()
    assert counted.actions.tolist() == [actions[action] for action in range(4)]
    assert counted.lengths == Counter(len(episode) for _, episode, _ in replayed)
    assert list(counted.lengths) == sorted(counted.lengths)
    assert counted.longest == max(len(episode) for _, episode, _ in replayed)
    assert counted.mean_moves == pytest.approx(np.mean([len(e) for _, e, _ in replayed]))
    returns = [sum(row["rewards"] for row in of) for _, _, of in replayed]
    assert counted.mean_return == pytest.approx(np.mean(returns))
    assert counted.action_shares.sum() == pytest.approx(1)
    if name == DEFAULT:
        for labyrinth, episode, _ in replayed:
            moves, far = labyrinth.structure.moves, distances(labyrinth)
            for state, action in zip(episode.states, episode.actions.tolist(), strict=False):
                nearer = [far[after] < far[state.agent] for after in moves[state.agent]]
                choices.append(sum(nearer))
                optimal.append(nearer[action])
        assert counted.choices == pytest.approx(np.mean(choices))
        assert counted.optimal == pytest.approx(np.mean(optimal))
    loops = [
        len(list(s.passages())) - s.cells + 1
        for s in (parse(text).structure for text in labyrinths(folder, split))
    ]
    assert counted.loops == pytest.approx(np.mean(loops))


def test_the_demonstrations_of_shortest_routes_are_optimal_and_the_random_policy_is_not(carded):
    of = measured(carded / DEFAULT).of
    assert {of(split).optimal for split in SPLITS if split != "random"} == {1.0}
    assert of("random").optimal < 0.6


def test_the_examples_are_the_first_labyrinths_with_their_first_episodes(carded):
    for split in SPLITS:
        first = dict.fromkeys(labyrinths(carded / OTHER, split))
        for labyrinth, episode, of in reversed(episodes(carded / OTHER, split)):
            first[of[0]["info"]] = (labyrinth, tuple(episode.actions.tolist()))
        assert list(measured(carded / OTHER).of(split).examples) == list(first.values())[:5]


def test_shards_and_workers_change_nothing(carded, build_dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(build, "CELLS_PER_SHARD", 9 * 3)
    folder = build_dataset(tmp_path, "3x3", labyrinths=7, random_steps=25)
    manifest = Manifest.read(folder)
    assert len(manifest.of("train")) == 3
    seen = []
    cut, whole = measure(folder, manifest, 2, seen.append), measured(carded / DEFAULT)
    assert sum(seen) == cut.rows == whole.rows
    assert cut.certificate == whole.certificate
    for one, other in zip(cut.splits, whole.splits, strict=True):
        assert one.lengths == other.lengths
        assert (one.visits == other.visits).all()
        assert one.examples == other.examples
        assert one.actions.tolist() == other.actions.tolist()
        assert one.mean_return == pytest.approx(other.mean_return)
        assert (one.choices, one.optimal, one.loops) == (other.choices, other.optimal, other.loops)


def test_the_certificate_of_a_dataset_that_was_built_is_clean(carded):
    for name in (DEFAULT, OTHER):
        certificate = measured(carded / name).certificate
        assert list(certificate.problems()) == []
        pairs = [(overlap.first, overlap.second) for overlap in certificate.overlaps]
        assert pairs == list(combinations(SAMPLED_SPLITS, 2))


def test_a_structure_copied_from_train_to_test_is_found(folder):
    copied = labyrinths(folder / DEFAULT, "train")[2]
    plant(folder / DEFAULT, "test", labyrinths(folder / DEFAULT, "test")[0], copied)
    overlaps = measured(folder / DEFAULT).certificate.overlaps
    assert [overlap[2:] for overlap in overlaps] == [(0, 0), (1, 1), (0, 0)]


def test_a_structure_that_is_the_mirror_image_of_one_in_train_is_found(folder):
    images = [text for text in labyrinths(folder / DEFAULT, "train") if transposed(text) != text]
    mirrored = transposed(images[0])
    plant(folder / DEFAULT, "validation", labyrinths(folder / DEFAULT, "validation")[4], mirrored)
    certificate = measured(folder / DEFAULT).certificate
    assert [overlap[2:] for overlap in certificate.overlaps] == [(0, 1), (0, 0), (0, 0)]
    assert list(certificate.problems()) == [
        "train and validation share 0 structures, 1 when mirror images count"
    ]


def test_a_structure_that_comes_twice_in_a_split_is_found(folder):
    texts = labyrinths(folder / DEFAULT, "test")
    plant(folder / DEFAULT, "test", texts[0], texts[3])
    certificate = measured(folder / DEFAULT).certificate
    assert certificate.repeated == {"train": 0, "validation": 0, "test": 1}
    assert list(certificate.problems()) == ["test repeats 1 structures"]


def test_a_structure_of_s0_that_is_not_one_of_train_is_found(folder):
    other = parse(labyrinths(folder / DEFAULT, "test")[0])
    old = parse(labyrinths(folder / DEFAULT, "s0")[0])
    new = dump(Labyrinth(other.structure, old.start, old.goal))
    plant(folder / DEFAULT, "s0", dump(old), new)
    certificate = measured(folder / DEFAULT).certificate
    assert certificate.strangers == {"random": 0, "s0": 1, "s0_and_g": 0}
    assert list(certificate.problems()) == ["s0 has 1 structures that are not in train"]


def test_a_file_that_is_not_the_manifests_is_refused(folder):
    path = shard(folder / DEFAULT, "train")
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(DatasetError, match="is not the file that its manifest describes"):
        measured(folder / DEFAULT)


def test_a_missing_file_is_named(folder):
    shard(folder / DEFAULT, "s0").unlink()
    with pytest.raises(DatasetError, match=r"s0-00000-of-00001\.parquet is missing"):
        measured(folder / DEFAULT)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table.drop_columns(["actions"]), "cannot be read"),
        (lambda table: table.slice(1), "does not begin with an episode"),
        (lambda table: table.slice(0, len(table) - 1), "does not end with its last row"),
        (lambda table: table.slice(0, 0), "does not begin|holds 0 labyrinths"),
    ],
)
def test_rows_that_make_no_episodes_are_refused_in_one_line(folder, change, message):
    write(folder / DEFAULT, "train", change(pq.read_table(shard(folder / DEFAULT, "train"))))
    with pytest.raises(DatasetError, match=message) as caught:
        measured(folder / DEFAULT)
    assert "\n" not in str(caught.value)


def test_a_text_that_is_no_labyrinth_is_refused_in_one_line(folder):
    plant(folder / DEFAULT, "train", labyrinths(folder / DEFAULT, "train")[0], "no labyrinth")
    with pytest.raises(DatasetError, match="cannot be read") as caught:
        measured(folder / DEFAULT)
    assert "\n" not in str(caught.value)
