"""The stage `analyse`: what it writes and says."""

from __future__ import annotations

import json
import shutil

import pytest
from support.making import perform
from support.planting import labyrinths

from labyrinth_core.data import SPLITS, Manifest
from labyrinth_core.language import labyrinth_id


@pytest.fixture(scope="module")
def analysed(small_dataset, tmp_path_factory):
    """The folder of a dataset that was analysed; not to be changed."""
    folder = tmp_path_factory.mktemp("analysed") / "labyrinth"
    shutil.copytree(small_dataset.data_dir, folder)
    return folder / "3x3"


def run_on(make_run, data_dir, **options):
    perform("analyse", make_run(data_dir, stages=["analyse"], **options))


def test_a_dataset_that_was_built_shares_nothing_and_its_analysis_lies_beside_it(
    analysed, make_run, capsys
):
    run_on(make_run, analysed.parent)
    content = json.loads((analysed / Manifest.ANALYSIS).read_bytes())
    assert content["fingerprint"] == Manifest.read(analysed).fingerprint
    leakage, shift = content["leakage"], content["shift"]
    assert leakage["labyrinths"] == dict.fromkeys(SPLITS.base, 8)
    assert leakage["repeated"] == dict.fromkeys(SPLITS.base, 0)
    assert leakage["strangers"] == {"random": [], "s0": [], "s0_and_g": []}
    for pair in leakage["pairs"]:
        assert pair["equal"] == pair["mirrored"] == {}
        ids = {labyrinth_id(text) for text in labyrinths(analysed, pair["second"])}
        assert set(pair["nearest"]) == ids
    assert [pair["second"] for pair in leakage["pairs"]] == ["validation", "test", "test"]
    assert len(shift["measures"]) == 36
    assert {test["labyrinths"][0] for test in shift["measures"]} == {8}
    shown = capsys.readouterr().out.splitlines()
    counts = [len(pair["symmetric"]) for pair in leakage["pairs"]]
    assert counts == [1, 0, 0]
    turned = [
        "Mirrored with start and goal kept: none.",
        "Turned: 1 of validation in train.",
    ]
    assert shown == [
        "Leakage: no structure is in two splits, and none is repeated.",
        *turned,
        f"Wrote {analysed / Manifest.ANALYSIS} (near-duplicates, tests of shift).",
    ]


@pytest.mark.slow
def test_workers_and_another_run_change_no_byte(analysed, make_run):
    run_on(make_run, analysed.parent)
    before = (analysed / Manifest.ANALYSIS).read_bytes()
    run_on(make_run, analysed.parent, workers=2)
    assert (analysed / Manifest.ANALYSIS).read_bytes() == before
