"""The statistics and the certificate, against counting by hand."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from support.making import make
from support.planting import DEFAULT, OTHER, labyrinths, plant, rows, shard, transposed, write
from support.tampering import cut_short

from labyrinth_core.data import COLUMNS, SPLITS, Dataset, Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.language import dump, parse
from labyrinth_core.world import Labyrinth, Solver
from pipeline.inspection import statistics

pytestmark = pytest.mark.slow


def measured(folder):
    return statistics.count_dataset(Dataset.at(folder))


def episodes(folder, split):
    """Return the labyrinth and the replay of each episode of a split."""
    found = []
    for row in rows(folder, split):
        if row["episode_starts"]:
            found.append((row["info"], []))
        found[-1][1].append(row)
    return [
        (parse(info), parse(info).replay([row["actions"] for row in of[:-1]]), of)
        for info, of in found
    ]


@pytest.mark.parametrize("split", SPLITS.base)
@pytest.mark.parametrize("name", [DEFAULT, OTHER])
def test_every_number_is_what_replaying_the_rows_gives(both, name, split):
    folder = both / name
    counted = measured(folder).splits[split]
    replayed = episodes(folder, split)
    visits = np.zeros(counted.visits.shape, int)
    actions, choices, optimal = Counter(), [], []
    for labyrinth, episode, _ in replayed:
        for state in episode.states:
            visits[divmod(state.agent, labyrinth.structure.width)] += 1
        actions.update(episode.actions.tolist())
    assert counted.labyrinths == len(labyrinths(folder, split))
    assert counted.episodes == len(replayed)
    assert counted.rows == len(rows(folder, split)) == visits.sum()
    assert (counted.visits == visits).all()
    assert counted.actions.tolist() == [actions[action] for action in range(4)]
    assert counted.lengths == Counter(len(episode) for _, episode, _ in replayed)
    assert counted.longest == max(len(episode) for _, episode, _ in replayed)
    assert counted.mean_moves == pytest.approx(np.mean([len(e) for _, e, _ in replayed]))
    returns = [sum(row["rewards"] for row in of) for _, _, of in replayed]
    assert counted.mean_return == pytest.approx(np.mean(returns))
    assert counted.action_shares.sum() == pytest.approx(1)
    if name == DEFAULT:
        for labyrinth, episode, _ in replayed:
            moves, far = labyrinth.structure.moves, Solver(labyrinth).distances
            for state, action in zip(episode.states, episode.actions.tolist(), strict=False):
                nearer = [far[after] < far[state.agent] for after in moves[state.agent]]
                choices.append(sum(nearer))
                optimal.append(nearer[action])
        assert counted.mean_choices == pytest.approx(np.mean(choices))
        assert counted.optimal_share == pytest.approx(np.mean(optimal))
    held = [parse(text) for text in labyrinths(folder, split)]
    loops = [len(list(of.structure.passages())) - of.structure.cells + 1 for of in held]
    assert counted.loops == Counter(loops)
    assert counted.mean_loops == pytest.approx(np.mean(loops))
    ways = [Counter(cell for pair in of.structure.passages() for cell in pair) for of in held]
    assert counted.junctions == Counter(sum(n > 2 for n in of.values()) for of in ways)
    assert counted.moves == Counter(len(Solver(of).shortest_routes()[0]) for of in held)


def test_the_examples_are_the_first_labyrinths_with_their_first_episodes(both):
    for split in SPLITS.base:
        first = dict.fromkeys(labyrinths(both / OTHER, split))
        for labyrinth, episode, of in reversed(episodes(both / OTHER, split)):
            first[of[0]["info"]] = (labyrinth, tuple(episode.actions.tolist()))
        assert list(measured(both / OTHER).splits[split].examples) == list(first.values())[:5]


def test_shards_and_workers_change_nothing(both, tmp_path):
    folder = make(tmp_path, "3x3", labyrinths=7, random_steps=25, cells_per_shard=9 * 3)
    manifest = Manifest.read(folder)
    assert len(manifest.of("train")) == 3
    cut, whole = statistics.count_dataset(Dataset.at(folder, manifest), 2), measured(both / DEFAULT)
    assert cut.certificate == whole.certificate
    for split, counts in cut.splits.items():
        one, other = vars(counts), vars(whole.splits[split])
        assert one.pop("returned") == pytest.approx(other.pop("returned"))
        np.testing.assert_equal(one, other)


def other_than_its_image(folder):
    """Return a labyrinth of train that is not its own mirror image."""
    return next(text for text in labyrinths(folder, "train") if transposed(text) != text)


def elsewhere(folder):
    """Return a structure of test with start and goal of the first labyrinth of s0."""
    structure = parse(labyrinths(folder, "test")[0]).structure
    ends = parse(labyrinths(folder, "s0")[0])
    return dump(Labyrinth(structure, ends.start, ends.goal))


SHARE = "train and {} share {}, 1 counting mirror images"


@pytest.mark.parametrize(
    ("split", "planted", "problem"),
    [
        (
            "test",
            lambda folder: labyrinths(folder, "train")[2],
            SHARE.format("test", "1 structure"),
        ),
        (
            "validation",
            lambda folder: transposed(other_than_its_image(folder)),
            SHARE.format("validation", "0 structures"),
        ),
        ("test", lambda folder: labyrinths(folder, "test")[3], "test repeats 1 structure"),
        ("s0", elsewhere, "s0 has 1 structure not found in train"),
    ],
    ids=["a copy", "a mirror image", "twice in a split", "not one of train"],
)
def test_a_structure_that_is_where_it_should_not_be_is_found(folder, split, planted, problem):
    plant(
        folder / DEFAULT, split, labyrinths(folder / DEFAULT, split)[0], planted(folder / DEFAULT)
    )
    assert list(measured(folder / DEFAULT).certificate.problems()) == [problem]


def with_another_last_byte(path):
    content = path.read_bytes()
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))


def put_first(folder, text):
    """Put a text in the place of the first labyrinth of train."""
    plant(folder, "train", labyrinths(folder, "train")[0], text)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda folder: cut_short(shard(folder, "train")),
            r"is damaged: it has \d+ bytes, and the manifest says \d+; delete it, and build",
        ),
        (
            lambda folder: with_another_last_byte(shard(folder, "train")),
            "is damaged: its sha256 is not the manifest's; delete it, and build",
        ),
        (
            lambda folder: write(folder, "train", COLUMNS.arrow_schema().empty_table()),
            "holds 0 labyrinths",
        ),
        (
            lambda folder: put_first(folder, labyrinths(folder.parent / OTHER, "train")[0]),
            "parquet cannot be read: .* is 3x4, not 3x3$",
        ),
        (lambda folder: put_first(folder, "no labyrinth"), "cannot be read"),
    ],
    ids=["cut short", "damaged", "empty", "of another size", "no labyrinth"],
)
def test_shards_that_are_damaged_or_hold_something_else_are_refused_in_one_line(
    folder, change, message
):
    change(folder / DEFAULT)
    with pytest.raises(DatasetError, match=message) as caught:
        measured(folder / DEFAULT)
    assert "\n" not in str(caught.value)
