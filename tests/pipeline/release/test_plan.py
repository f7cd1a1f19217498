"""What a release changes on the Hub, told from hashes alone."""

from __future__ import annotations

from pipeline.release.plan import DATASET, make_plan


def test_only_what_a_release_has_left_on_the_hub_is_replaced_or_deleted(tmp_path):
    names = ("CITATION.cff", "eval.yaml", "README.md", "2x2/train-00000-of-00001.parquet")
    there = dict.fromkeys(names, "0" * 40)
    here = {name: tmp_path / name for name in ("README.md", "eval.yaml", "croissant.json")}
    for path in here.values():
        path.write_text("ours")
    ours = {"CITATION.cff", "README.md", "2x2/train-00000-of-00001.parquet"}
    plan = make_plan(DATASET, here, there, lambda _: ours)
    assert plan.add == list(here)
    assert plan.delete == ["2x2/train-00000-of-00001.parquet", "CITATION.cff"]
    assert plan.others == ["eval.yaml"]
    assert make_plan(DATASET, here, there).others == ["README.md", "eval.yaml"]
