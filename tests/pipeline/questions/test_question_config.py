"""The questions beside a dataset: made once, loadable, validated, listed, and of its rows."""

from __future__ import annotations

from dataclasses import replace

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.asking import NAME, SPLITS, TEST, asked, copied
from support.making import perform
from support.tampering import content_of

from labyrinth_core import load_transitions
from labyrinth_core.data import Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.language import parse
from labyrinth_core.questions import QUESTION_COLUMNS
from labyrinth_core.storage import File
from labyrinth_core.world import Solver
from pipeline.generation import check

__all__ = ["asked", "copied"]

pytestmark = pytest.mark.slow


def test_the_questions_load_and_are_one_for_each_labyrinth_of_test_and_shifts(asked):
    from datasets import load_dataset

    loaded = load_dataset(str(asked.data_dir), f"{NAME}-questions")
    table = load_dataset(str(asked.data_dir), f"{NAME}-labyrinths", split="labyrinths")
    assert list(loaded) == SPLITS
    for split, rows in loaded.items():
        assert rows.column_names == [column.name for column in QUESTION_COLUMNS]
        assert rows["labyrinth_id"] == [r["labyrinth_id"] for r in table if r["split"] == split]
        assert rows[0]["image"].size == (600, 600)
        assert rows[0]["image_300"].size == (300, 300)
        for row in rows.remove_columns(["image", "image_300"]):
            assert (row["moves"], len(row["routes"])) == Solver(
                parse(row["info"])
            ).moves_and_routes()
    with pytest.raises(DatasetError, match=f"holds {NAME}$"):  # They have no episodes.
        load_transitions(asked.data_dir, f"{NAME}-questions", split="test")


def test_a_second_run_writes_nothing_and_one_after_damage_writes_the_same(copied, capsys):
    folder = copied.data_dir / f"{NAME}-questions"
    before = content_of(copied.data_dir)
    perform("questions", copied)
    assert "is there already" in capsys.readouterr().out
    (folder / TEST).write_bytes(b"damaged")
    with pytest.raises(DatasetError, match=f"{TEST}, damaged or changed .*: give overwrite=true"):
        perform("questions", copied)
    perform("questions", replace(copied, options=replace(copied.options, overwrite=True)))
    assert content_of(copied.data_dir) == before


def test_the_questions_are_validated(copied, capsys):
    check.run(copied)
    assert "16 questions" in capsys.readouterr().out
    folder = copied.data_dir / f"{NAME}-questions"
    rows = pq.read_table(folder / TEST)
    changed = rows.to_pylist()
    changed[2]["answer"], changed[3]["moves"] = "up", 1
    pq.write_table(pa.Table.from_pylist(changed, rows.schema), folder / TEST)
    with pytest.raises(DatasetError, match=f"{TEST} is damaged"):
        check.run(copied)
    manifest = Manifest.read(folder, companion="questions")
    now = {"sha256": File(folder / TEST).sha256(), "bytes": (folder / TEST).stat().st_size}
    shards = [replace(shard, **now) if shard.path == TEST else shard for shard in manifest.shards]
    replace(manifest, shards=tuple(shards)).write(folder)
    with pytest.raises(DatasetError) as error:
        check.run(copied)
    found = f"{error.value}".splitlines()[1:]
    assert [line.split(TEST)[1] for line in found] == [
        " row 2 answer: not what the labyrinth gives",
        " row 3 moves: not what the labyrinth gives",
    ]


def test_nothing_of_a_user_is_lost_and_a_hidden_labyrinth_is_not_asked_about(
    copied, build, tmp_path
):
    folder = copied.data_dir / f"{NAME}-questions"
    for name in ("mine.txt", ".DS_Store"):
        (folder / name).write_text("mine")
    before = content_of(folder)
    perform("questions", copied)  # Nothing is to be replaced.
    assert content_of(folder) == before
    (folder / TEST).unlink()
    del before[TEST]
    with pytest.raises(DatasetError, match=r"holds mine\.txt, which would be lost"):
        perform("questions", copied)
    assert content_of(folder) == before
    (folder / "mine.txt").unlink()
    perform("questions", copied)
    assert (folder / TEST).is_file()
    hidden = build(tmp_path / "hidden", labyrinths=2, task="partial_observability")
    with pytest.raises(DatasetError, match="hidden from the agent"):
        perform("questions", hidden)
    assert sorted(path.name for path in hidden.data_dir.iterdir()) == [
        "3x3-partial_observability",
        "README.md",
    ]
