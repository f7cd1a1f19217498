"""Leakage in labyrinths from elsewhere: named with their files, beside what cannot be read."""

from __future__ import annotations

import io
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.commands import refused
from support.known_labyrinths import BARE, GRID, LABYRINTH, changed
from support.making import perform
from support.planting import labyrinths, transposed
from support.tampering import folder_behind_link

from labyrinth_core.data import SPLITS, Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.language import labyrinth_id
from pipeline.certify.options import CertifyOptions


def run_on(make_run, data_dir, **options):
    perform("certify", make_run(data_dir, stages=["certify"], **options))


@pytest.fixture
def files(small_dataset, tmp_path):
    """A folder of files by split, two of which leak."""
    texts = {split: labyrinths(small_dataset.folder, split) for split in SPLITS.sampled}
    images = [text for text in texts["train"] if transposed(text) != text]
    texts["test"] += [texts["validation"][0], transposed(images[0])]
    for split, of in texts.items():
        folder = tmp_path / "files" / split
        folder.mkdir(parents=True)
        for number, text in enumerate(of):
            (folder / f"{number:02}.labyrinth").write_text(text, encoding="utf-8")
    return tmp_path / "files"


def certified(make_run, source, tmp_path, config=None):
    data_dir = tmp_path / "data"
    run_on(make_run, data_dir, certify=CertifyOptions(str(source), config))
    (path,) = (data_dir / "analysis").rglob("*.json")
    content = json.loads(path.read_bytes())
    assert content["source"] == str(source)
    pairs = {(pair["first"], pair["second"]): pair for pair in content["leakage"]["pairs"]}
    return content, pairs


def test_files_by_split_are_certified_and_those_that_leak_are_named(
    files, make_run, tmp_path, capsys
):
    content, pairs = certified(make_run, files, tmp_path)
    assert list(pairs) == [("train", "validation"), ("train", "test"), ("validation", "test")]
    (equal,) = pairs["validation", "test"]["equal"].items()
    assert content["files"]["test"][equal[0]] == str(files / "test" / "08.labyrinth")
    assert content["files"]["validation"][equal[1]] == str(files / "validation" / "00.labyrinth")
    (mirrored,) = pairs["train", "test"]["mirrored"]
    assert content["files"]["test"][mirrored] == str(files / "test" / "09.labyrinth")
    lines = capsys.readouterr().out.splitlines()
    test, validation = files / "test", files / "validation"
    assert f"{test / '08.labyrinth'} has the structure of {validation / '00.labyrinth'}" in lines
    named = [line for line in lines if "has a mirror image of" in line]
    assert len(named) == 1
    assert named[0].startswith(str(test / "09.labyrinth"))


def test_hidden_copies_are_no_data_and_deep_files_are(files, make_run, tmp_path):
    _, expected = certified(make_run, files, tmp_path / "before")
    for hidden in (files / ".ipynb_checkpoints", files / "test" / ".ipynb_checkpoints"):
        hidden.mkdir()
        shutil.copy(files / "train" / "00.labyrinth", hidden / "00-checkpoint.labyrinth")
        (hidden / "rows.parquet").touch()
    _, pairs = certified(make_run, files, tmp_path / "hidden")
    assert pairs == expected
    (files / "test" / "hard").mkdir()
    shutil.move(files / "test" / "08.labyrinth", files / "test" / "hard")
    _, pairs = certified(make_run, files, tmp_path / "deep")
    assert pairs == expected


def test_the_configs_of_a_source_are_certified_side_by_side(files, make_run, tmp_path):
    data_dir = tmp_path / "data"
    for config in (None, "3x3", "..", "4x4"):
        run_on(make_run, data_dir, certify=CertifyOptions(str(files), config))
    made = [json.loads(path.read_bytes()) for path in (data_dir / "analysis").rglob("*.json")]
    assert sorted(str(each["config"]) for each in made) == ["..", "3x3", "4x4", "None"]
    assert [path.name for path in data_dir.iterdir()] == ["analysis"]


def grids(folder, **arrays):
    folder.mkdir()
    for split, array in arrays.items():
        np.save(folder / split, array)
    return folder


def test_arrays_are_certified_by_the_names_of_their_files(make_run, tmp_path, capsys):
    tests = np.stack([GRID, changed(3, 2, 0)])
    path = grids(tmp_path / "grids", train=np.stack([GRID, GRID]), test=tests)
    content, pairs = certified(make_run, path, tmp_path)
    assert content["leakage"]["repeated"] == {"train": 1, "test": 0}
    assert not content["structures_alone"]
    pair = pairs["train", "test"]
    assert pair["equal"] == {labyrinth_id(LABYRINTH): labyrinth_id(LABYRINTH)}
    assert pair["within"]["1"] == 2
    assert content["files"]["train"] == {labyrinth_id(LABYRINTH): f"{path}/train.npy[0]"}
    lines = capsys.readouterr().out.splitlines()
    assert f"{path}/test.npy[0] has the structure of {path}/train.npy[0]" in lines
    assert "train repeats 1 structure" in lines


def test_where_ends_are_unknown_structures_alone_are_compared(make_run, tmp_path, capsys):
    tests = np.stack([BARE[:, ::-1], GRID])
    folder = grids(tmp_path / "grids", train=np.stack([BARE, BARE]), test=tests)
    content, pairs = certified(make_run, folder, tmp_path)
    assert content["structures_alone"]
    assert content["leakage"]["repeated"] == {"train": 1, "test": 0}
    pair = pairs["train", "test"]
    ids = {LABYRINTH.structure.structure_id, LABYRINTH.structure.mirrored().structure_id}
    assert set(pair["mirrored"]) == set(pair["symmetric"]) == set(pair["nearest"]) == ids
    assert set(pair["equal"]) == {LABYRINTH.structure.structure_id}
    assert pair["same_route"] == {}
    shown = capsys.readouterr().out
    assert "only structures are compared" in shown
    assert re.search(r"train, test +2 +1 +2 +2 .* - +0", shown)


def test_what_cannot_be_read_is_told_after_the_rest_is_certified(make_run, tmp_path, capsys):
    trains = np.stack([GRID] + [changed(0, 1, 0)] * 11)
    path = grids(tmp_path / "grids", train=trains, test=GRID)
    first = f"{path}/train.npy[1]: row 0, column 1: a gap in the outer wall"
    with pytest.raises(DatasetError, match=r"^11 labyrinths or files could not be read") as caught:
        certified(make_run, path, tmp_path)
    assert str(caught.value).endswith(f"; the first: {first}")
    (made,) = (tmp_path / "data" / "analysis").rglob("*.json")
    content = json.loads(made.read_bytes())
    assert content["leakage"]["labyrinths"] == {"train": 1, "test": 1}
    assert len(content["problems"]) == 11
    lines = capsys.readouterr().out.splitlines()
    assert sum("a gap in the outer wall" in line for line in lines) == 9


@pytest.mark.parametrize("kind", ["labyrinth", "parquet"])
def test_a_link_that_leads_nowhere_is_told_after_the_rest_is_certified(
    small_dataset, make_run, tmp_path, capsys, kind
):
    folder = tmp_path / "mine"
    (folder / "train").mkdir(parents=True)
    texts = labyrinths(small_dataset.folder, "train")
    if kind == "parquet":
        pq.write_table(table_of(texts), folder / "train" / "0.parquet")
    else:
        (folder / "train" / "0.labyrinth").write_text(texts[0])
    (folder / "test").mkdir()
    (folder / "test" / f"1.{kind}").symlink_to("/unplugged")
    problem = rf"^1 labyrinths or files .* the first: \S*/test/1\.{kind}: a link that leads nowhere"
    with pytest.raises(DatasetError, match=problem):
        certified(make_run, folder, tmp_path)
    assert "Leakage: " in capsys.readouterr().out


def test_a_dataset_in_parquet_is_certified_as_our_own_is(small_dataset, make_run, tmp_path):
    folder = shutil.copytree(small_dataset.data_dir, tmp_path / "labyrinth")
    perform("analyse", make_run(folder, stages=["analyse"]))
    own = json.loads((folder / "3x3" / Manifest.ANALYSIS).read_bytes())
    _, pairs = certified(make_run, folder, tmp_path, "3x3")
    assert list(pairs.values()) == own["leakage"]["pairs"]


def table_of(texts):
    return pa.table({"obs": [b""] * len(texts), "info": texts})


def test_only_the_texts_of_a_dataset_are_needed(small_dataset, make_run, tmp_path, capsys):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    texts = labyrinths(small_dataset.folder, "train")
    pq.write_table(table_of(texts[:5] * 2), folder / "train.parquet")
    pq.write_table(table_of(texts[4:]), folder / "test.parquet")
    content, pairs = certified(make_run, folder, tmp_path)
    assert content["leakage"]["labyrinths"] == {"train": 5, "test": 4}
    number = labyrinth_id(texts[4])
    assert pairs["train", "test"]["equal"] == {number: number}
    assert f"test {number} has the structure of train {number}" in capsys.readouterr().out


def parquet_of(texts):
    out = io.BytesIO()
    pq.write_table(table_of(texts), out)
    return out.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.npy", b"no array", "a.npy: the array cannot be read"),
        ("a.zip", b"PK\5\6" + bytes(18), "a.zip: unpack this archive and give the folder"),
        ("a.csv", b"", "a.csv: the name of a file must end in .labyrinth, .npy"),
        ("folder", parquet_of(["no labyrinth"]), "train info: not a labyrinth: "),
        ("folder", parquet_of([1]), "every row needs a text"),
        ("nobody/nothing", None, "nobody/nothing is neither a folder"),
    ],
)
def test_a_source_without_labyrinths_is_refused_in_one_line(
    make_run, tmp_path, monkeypatch, name, content, message
):
    monkeypatch.chdir(tmp_path)
    path = Path(name) if "." in name else Path(name, "train.parquet")
    if content is not None:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    with pytest.raises(DatasetError, match=re.escape(message)) as caught:
        certified(make_run, name, tmp_path)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("added", ["x: &x {a: *x}", "x: !!timestamp abc", "x: [", "1: x"])
def test_a_source_whose_front_matter_cannot_be_read_is_refused_in_one_line(
    small_dataset, make_run, tmp_path, added
):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    texts = labyrinths(small_dataset.folder, "train")
    pq.write_table(table_of(texts), folder / "train.parquet")
    info = "dataset_info:\n  features:\n  - name: info\n    dtype: string\n"
    (folder / "README.md").write_text(f"---\n{info}{added}\n---\n")
    with pytest.raises(DatasetError, match="cannot be read") as caught:
        certified(make_run, folder, tmp_path)
    assert "\n" not in str(caught.value)


def test_no_analysis_is_written_through_a_link(files, make_run, tmp_path):
    (tmp_path / "data").mkdir()
    elsewhere = folder_behind_link(tmp_path / "data" / "analysis", tmp_path)
    with pytest.raises(DatasetError, match="analysis is a link, and nothing is written through it"):
        certified(make_run, files, tmp_path)
    assert list(elsewhere.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["certify.config=a"], "certify.source=: give what to certify"),
        (["certify.source=gymnasium:A-v0"], "certify.train=: give its seeds"),
        (["certify.source=a.npy", "certify.test=0:9"], "certify.source=a.npy: labyrinths have"),
    ],
)
def test_options_that_do_not_fit_are_refused_in_one_line(options, message):
    assert message in refused("stages=certify", *options)
