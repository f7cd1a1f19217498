"""Files of records: written by a certificate or by the recorder, and damaged in every way."""

from __future__ import annotations

import json
import runpy
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from support.deceiving import Corridor, SeedIgnored

from labyrinth_core import certify
from labyrinth_core.benchmarks import CertifyError, repeats

RECORDER = Path(__file__).parents[3] / "examples" / "record_levels.py"
record = runpy.run_path(str(RECORDER))["record"]
SPLITS = {"train": range(6), "test": range(100, 160)}
ROW = {"split": "train", "seed": 0, "first": "aa", "probes": ["bb"], "state": None}


def level_of(env):
    return env.level


@pytest.fixture
def certificate(monkeypatch):
    monkeypatch.setattr(repeats, "_new_interpreters", lambda *_: ())
    return certify(Corridor, **SPLITS, probes=1, steps=8, state=level_of)


def test_the_json_has_all_that_is_needed_to_make_it_again(certificate, tmp_path):
    certificate.save(tmp_path / "one.json")
    text = (tmp_path / "one.json").read_text()
    content = json.loads(text)
    arguments = content["arguments"] | {"environment": Corridor}
    arguments["state"] = level_of
    certify(**arguments).save(tmp_path / "two.json")
    assert (tmp_path / "two.json").read_text() == text
    assert content["measures"]["probes"]["count"] == 36
    assert content["disjoint"] == certificate.disjoint() == [106, 107, 108, 109]
    assert content["levels"] | {"seen": 10, "coverage": 1, "at_least": 10} == content["levels"]


@pytest.mark.parametrize("name", ["records.jsonl", "records.parquet"])
def test_records_give_the_figures_of_the_certificate_that_wrote_them(certificate, tmp_path, name):
    certificate.save(tmp_path / name)
    again = certify(tmp_path / name)
    assert again.measures == certificate.measures
    assert again.levels == certificate.levels
    assert again.curves == certificate.curves
    assert again.disjoint() == certificate.disjoint()
    assert again.records == certificate.records
    assert again.environment == certificate.environment
    assert "none was checked" in str(again)


def test_a_certificate_is_a_section_in_markdown(certificate, tmp_path):
    certificate.save(tmp_path / "section.md")
    text = (tmp_path / "section.md").read_text()
    seeds = "6 train seeds (0:6), 60 test seeds (100:160)"
    assert text.startswith(f"## support.deceiving:Corridor: {seeds}")
    assert certificate.sentence in text
    assert "| probes | 36 of 60, 60.0% (47.4 to 71.4%) of test in train |" in text
    with pytest.raises(CertifyError, match=r"certificate.txt: give a name that ends in .json, .md"):
        certificate.save("certificate.txt")


class Older(Corridor):
    """gym 0.21: a seed of its own, observations alone, one flag for the end."""

    def seed(self, seed):
        self._seed = seed

    def reset(self):
        return super().reset(seed=self._seed)[0]

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward, terminated or truncated, info


class Gym3:
    """gym3: one batch, made for a seed, with acts and observations apart."""

    def __init__(self, seed):
        self.env = Corridor()
        self.seen = 0.0, self.env.reset(seed=seed)[0], True

    def observe(self):
        return tuple(np.array([each]) for each in self.seen)

    def act(self, actions):
        observation, reward, terminated, truncated, _ = self.env.step(actions[0])
        self.seen = reward, observation, terminated or truncated


THE_SAME = Corridor(), Older()


@pytest.mark.parametrize(
    "make",
    [lambda _: THE_SAME[0], lambda _: THE_SAME[1], Gym3],
    ids=["Gymnasium", "gym 0.21", "gym3"],
)
def test_the_recorder_gives_the_figures_of_the_environment(certificate, tmp_path, make):
    path = tmp_path / "records.jsonl"
    for _ in range(2):
        record(path, make, SPLITS, [[1] * 20, [0, 1] * 4])
    found = certify(str(path))
    assert found.measures == {key: certificate.measures[key] for key in ("first", "probes")}
    assert found.checked == "66 were recorded more than once"
    assert found.disjoint() == certificate.disjoint()


def test_a_state_is_recorded_before_the_first_step(tmp_path):
    path = tmp_path / "records.jsonl"
    record(path, lambda _: Corridor(), SPLITS, [[1] * 3], state=lambda env: [env.level, env.steps])
    assert certify(path).state.count == 36


def test_seeds_of_any_size_are_written_as_json_lines_alone(certificate, tmp_path):
    large = replace(certificate, train=replace(certificate.train, seeds=(*range(5), 10**25)))
    large.save(tmp_path / "large.jsonl")
    assert certify(tmp_path / "large.jsonl").train.seeds == large.train.seeds
    with pytest.raises(CertifyError, match="Parquet holds seeds below"):
        large.save(tmp_path / "large.parquet")


def test_seeds_that_were_recorded_differently_are_refused(tmp_path):
    path = tmp_path / "records.jsonl"
    for _ in range(2):
        record(path, lambda _: SeedIgnored(), {"train": [0], "test": [1]}, [[1]])
    found = certify(path)
    assert found.measures == {}
    assert found.reasons["first"] == "train seed 0 was recorded twice, with two values of first"


def lines(*rows):
    return "\n".join(json.dumps(row) for row in rows).encode()


TEST = ROW | {"split": "test"}
DAMAGED = {
    "empty": (b"", "no row has split train"),
    "not JSON": (b"\x89PNG\r\n", "line 1: not JSON"),
    "deep": (b"[" * 100_000, "line 1: not JSON"),
    "long": (b" " * (1 << 20) + b"1", "line 1: longer than 1,048,576 bytes"),
    "cut": (lines(ROW, TEST)[:-9], "line 2: not JSON"),
    "a list": (b"[1]", r"line 1: not a record: \[1\]"),
    "one split": (lines(ROW), "no row has split test"),
    "another split": (lines(ROW, ROW | {"split": "val"}), "line 2: split=val: give train or test"),
    "a seed": (lines(ROW | {"seed": True}), "line 1: seed=True: give a whole number"),
    "a digest": (lines(ROW | {"first": 5}), "line 1: first=5: give a digest as a text"),
    "a long digest": (lines(ROW | {"first": "a" * 129}), "line 1: first=a+: give a digest"),
    "probes": (lines(ROW | {"probes": []}), r"line 1: probes=\[\]: give a list of digests"),
    "a probe": (lines(ROW | {"probes": [{}]}), r"line 1: probes=\{\}: give a digest"),
    "a large number": (b'{"split": "train", "seed": ' + b"9" * 5000 + b"}", "line 1: not JSON"),
}


@pytest.mark.parametrize(("content", "message"), DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_file_gets_one_line(tmp_path, content, message):
    path = tmp_path / "records.jsonl"
    path.write_bytes(content)
    with pytest.raises(CertifyError, match=f"records.jsonl.*{message}") as raised:
        certify(path)
    assert "\n" not in str(raised.value)


def test_a_foreign_parquet_file_gets_one_line(tmp_path):
    path = tmp_path / "records.parquet"
    path.write_bytes(b"PAR1 and no more")
    with pytest.raises(CertifyError, match="not a Parquet file, or a damaged one"):
        certify(path)
    pyarrow.parquet.write_table(pyarrow.table({"obs": [1]}), path)
    with pytest.raises(CertifyError, match="not a file of records: it has no column split"):
        certify(path)
    columns = {"split": ["train", "test"], "seed": [0.5, 1.0]}
    pyarrow.parquet.write_table(pyarrow.table(columns), path)
    with pytest.raises(CertifyError, match=r"row 1: seed=0.5: give a whole number"):
        certify(path)


def test_what_records_cannot_have_is_refused(tmp_path):
    with pytest.raises(CertifyError, match=r"none.jsonl: No such file or directory"):
        certify("none.jsonl")
    path = tmp_path / "records.jsonl"
    path.write_bytes(lines(ROW, TEST))
    with pytest.raises(CertifyError, match="leave out train and test"):
        partial(certify, path)(range(3), range(3))
