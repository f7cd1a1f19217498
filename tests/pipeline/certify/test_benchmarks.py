"""The stage `certify` of anyone's benchmark: what it prints and writes."""

from __future__ import annotations

import json

import pytest
from support.deceiving import Corridor
from support.making import perform

from labyrinth_core import certify
from labyrinth_core.benchmarks import repeats
from labyrinth_core.errors import DatasetError
from pipeline.certify.options import CertifyOptions


def run_on(make_run, tmp_path, source, **options):
    certified = CertifyOptions(source, **options)
    perform("certify", make_run(tmp_path / "data", stages=["certify"], certify=certified))
    (path,) = (tmp_path / "data" / "analysis").rglob("*.json")
    return json.loads(path.read_bytes()), path


def test_records_are_printed_and_written_as_the_library_certifies_them(
    make_run, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(repeats, "_new_interpreters", lambda *_: ())
    records = str(tmp_path / "records.jsonl")
    certify(Corridor, range(6), range(100, 160), probes=1, steps=8).save(records)
    content, path = run_on(make_run, tmp_path, records)
    certificate = certify(records)
    assert content == json.loads(json.dumps(certificate.to_json()))
    printed = capsys.readouterr().out
    assert printed == f"{certificate}\n{certificate.sentence}\n{path} has the full results.\n"
    assert "36 of 60" in printed


@pytest.mark.slow
def test_an_environment_of_gymnasium_is_certified_by_its_id(make_run, tmp_path, capsys):
    seeds = {"train": "0:5", "test": "3:9,20"}
    content, _ = run_on(make_run, tmp_path, "gymnasium:CartPole-v1", **seeds, probes=1, steps=9)
    assert content["environment"] == "CartPole-v1"
    assert content["arguments"] | {"train": "0:5", "test": "3:9,20"} == content["arguments"]
    assert {share["count"] for share in content["measures"].values()} == {2}
    assert content["spread"]["values"] == 4
    assert "2 seeds are in train and in test" in capsys.readouterr().out


def test_what_cannot_be_certified_gets_one_line(make_run, tmp_path):
    seeds = {"train": "0:5", "test": "5:9"}
    with pytest.raises(DatasetError, match="Nothing-v0: Environment `Nothing` doesn't exist"):
        run_on(make_run, tmp_path, "gymnasium:Nothing-v0", **seeds)
    with pytest.raises(DatasetError, match=r"none.jsonl: No such file or directory"):
        run_on(make_run, tmp_path, "none.jsonl")
    assert not (tmp_path / "data").exists()
