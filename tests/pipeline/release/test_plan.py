"""What a release changes on the Hub, told from hashes alone."""

from __future__ import annotations

from pipeline.release.plan import DATASET, make_plan


def test_an_eval_file_of_a_person_stays_on_the_hub_where_the_release_has_none(tmp_path):
    there = dict.fromkeys(("CITATION.cff", "eval.yaml", "notes.txt"), "0" * 40)
    assert make_plan(DATASET, {}, there).delete == ["CITATION.cff"]
    ours = tmp_path / "eval.yaml"
    ours.write_text("name: Labyrinth\n")
    assert make_plan(DATASET, {"eval.yaml": ours}, there).add == ["eval.yaml"]
