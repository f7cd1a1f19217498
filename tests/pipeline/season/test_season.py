"""A season from its secret to its verification, and where the secret is until then: in its file."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
from pathlib import Path

import pytest
from seasons import Performer, seed_of
from support.policies import RELEASED
from support.publishing import local_hub, run_script

from labyrinth_core.evaluation import Results
from pipeline.config import ConfigError
from pipeline.generation import build
from pipeline.machinery import Sums
from pipeline.season import judge

__all__ = ["local_hub"]


FIGURES = r"SPL [01]\.\d\d, SR [01]\.\d\d"
"""The labyrinths are random, and the planner solves nearly all of them."""


def test_the_seed_follows_from_the_secret_as_the_documents_say(revealed):
    secret = bytes.fromhex(revealed.place.revealed.read_text(encoding="ascii"))
    assert f"The dataset has seed={seed_of(revealed.place, secret)} and" in revealed.printed
    assert len(secret) == 32


@pytest.mark.parametrize(
    ("stage", "options", "message"),
    [
        ("season", {"labyrinths": 15}, "labyrinths=15: give 16 or more, since fewer can be guess"),
        ("season", {"seed": 3}, "seed=3: a season makes its seed from its secret"),
        ("season", {"executor": "dask"}, "executor=dask: a season stays on one machine"),
        ("season", {"date": "2026-13-30"}, "season.date=2026-13-30: give the day on which the"),
        ("judge", {"submission": ""}, "season.submission=: give the policy to judge"),
        ("judge", {"submission": "a.zip"}, "season.submission=a.zip: give an id on the Hub"),
        ("judge", {"submission": "Oracle"}, "season.submission: name=Oracle: a baseline has this"),
    ],
)
def test_an_impossible_option_is_refused_in_one_line(tmp_path, make_run, stage, options, message):
    perform = Performer(tmp_path, make_run)
    with pytest.raises(ConfigError, match=message):
        perform(stage, **options)
    assert not perform.place.secret.exists()


def test_a_full_disk_leaves_no_secret_without_its_season(tmp_path, make_run, monkeypatch):
    perform = Performer(tmp_path, make_run)

    def fail(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match=r"No space left on device: '.*\.secret'"):
        perform("season")
    assert not perform.place.secret.exists()


@pytest.mark.slow
def test_until_it_is_revealed_the_secret_is_in_its_file_and_nowhere_else(hidden):
    place, said = hidden.place, hidden.printed
    judged = re.search(rf"planner-seed0 is judged: ({FIGURES}), in ", said)
    assert judged is not None
    assert f"planner-seed0 is judged again, with the same bytes: {judged[1]}, in " in said
    text = place.secret.read_text(encoding="ascii")
    secret = bytes.fromhex(text)
    seed = seed_of(place, secret)
    for stage, given, message in (
        ("season", {"date": "2026-12-01"}, "2026-a exists: choose another season.name"),
        ("season", {"labyrinths": 17}, "2026-a exists: choose another season.name"),
        ("season", {}, "season.json exists already: publish this folder now."),
        ("verify", {}, "is not revealed: secret.txt is missing"),
        ("judge", {"submission": "nowhere"}, "nowhere is neither a folder, a file, nor an id"),
        (
            "judge",
            {"submission": f"{RELEASED}@{'0' * 64}"},
            "model.safetensors differs from the named revision: it is ",
        ),
        ("judge", {"folder": "broken"}, "2026-a.secret holds no secret"),
        ("judge", {"folder": "others"}, "2026-a.secret holds another secret than the season com"),
    ):
        copy = hidden.folder / given.get("folder", "seasons")
        if not copy.exists():
            shutil.copytree(place.public.parent, copy)
            other = text.replace(text[0], "x") if copy.name == "broken" else "00" * 32
            (copy / place.secret.name).write_text(other, encoding="ascii")
        assert message in hidden(stage, **given)
        if copy.name != "seasons":
            shutil.rmtree(copy)

    assert len(secret) == 32
    if os.name == "posix":
        assert place.secret.stat().st_mode & 0o777 == 0o600
        assert place.private.stat().st_mode & 0o777 == 0o700
    contents = {path: path.read_bytes() for path in hidden.folder.rglob("*") if path.is_file()}
    assert contents.pop(place.secret) == text.encode()
    names = ["1.json", "config.json", "judged.json", "model.safetensors", "season.json"]
    assert sorted(path.name for path in contents) == sorted([*names, Sums.FILE, Sums.FILE])
    contents["printed"] = hidden.printed.encode()
    told = [secret[:8], secret[-8:], secret.hex()[:16].encode(), secret.hex()[-16:].encode()]
    told += [str(seed).encode(), f"{seed:x}".encode(), seed.to_bytes(8, "big")]
    told += [seed.to_bytes(8, "little")]
    assert [path for path, content in contents.items() for each in told if each in content] == []
    ids = Results.load(place.private / "1.json").splits["test"].labyrinth_ids.tolist()
    public = b"".join(path.read_bytes() for path in place.public.iterdir())
    assert not any(f"{number:016x}".encode() in public for number in ids)


@pytest.mark.slow
def test_the_files_of_a_judgement_that_was_interrupted_are_not_published(
    hidden, tmp_path, make_run
):
    perform = Performer(tmp_path, make_run)
    shutil.copytree(hidden.place.public.parent, perform.place.public.parent)
    kept = perform.place.private / "1"
    (kept / "model.onnx").write_bytes(b"of another person, whose judgement was killed")
    perform("reveal")
    names = [path.name for path in (perform.place.public / "submissions" / "1").iterdir()]
    assert sorted(names) == ["config.json", "model.safetensors"]


@pytest.mark.slow
def test_what_is_published_can_be_verified_and_a_change_of_it_is_found(revealed):
    public = revealed.place.public
    said = revealed("verify")
    assert "the secret and the content of the test match the commitment." in said
    assert "All 6 files of the test are identical." in said
    assert re.search(rf"planner-seed0 \| ({FIGURES}) \| \1 \| yes \|", said)
    row = json.loads((public / "judged.json").read_text(encoding="utf-8"))["judged"][0]
    results = Results.load(public / "results" / "1.json")
    assert results.judged is not None
    assert results.judged.files == row["files"]

    reported = public / "self-reported"
    reported.mkdir()
    shutil.copyfile(public / "results" / "1.json", reported / "a.json")
    told = json.loads((reported / "a.json").read_text(encoding="utf-8"))
    told["dataset"]["fingerprint"] = "0" * 64
    for name in ("b.json", ".b.json"):  # A hidden file is nobody's report.
        (reported / name).write_text(json.dumps(told), encoding="utf-8")
    rows = public / "judged.json"
    listed = json.loads(rows.read_text(encoding="utf-8"))
    listed["judged"][0]["figures"]["test"]["sr"] = 0.123
    rows.write_text(json.dumps(listed), encoding="utf-8")
    assert "2 of its claims cannot be confirmed" in revealed("verify")
    said = revealed.printed
    assert "self-reported, not verified: " in said
    assert "self-reported, and refused: it is of another dataset than" in said
    assert "no: judged.json contradicts the results" in said
    listed["judged"][0]["versions"] = {}
    rows.write_text(json.dumps(listed), encoding="utf-8")
    assert "2 of its claims cannot be confirmed" in revealed("verify")
    assert "no: its entry has no version of labyrinth-datasets, numpy, torch" in revealed.printed

    weights = public / "submissions" / "1" / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1] + b"!")
    assert "2 of its claims cannot be confirmed" in revealed("verify")
    season_file = public / "season.json"
    content = json.loads(season_file.read_text(encoding="utf-8")) | {"fingerprint": "0" * 64}
    season_file.write_text(json.dumps(content), encoding="utf-8")
    assert "gives another test than the season commits to" in revealed("verify")


@pytest.mark.slow
def test_a_file_of_a_person_is_not_written_over_when_a_season_is_revealed(
    hidden, tmp_path, make_run
):
    perform = Performer(tmp_path, make_run)
    shutil.copytree(hidden.place.public.parent, perform.place.public.parent)
    theirs = perform.place.public / "results" / "1.json"
    theirs.parent.mkdir()
    theirs.write_text("mine")
    assert "1.json: made or changed by someone else, so not overwritten" in perform("reveal")
    assert theirs.read_text() == "mine"
    assert not perform.place.revealed.exists()


ON_THE_HUB = """
import sys
from pathlib import Path

tests = Path(sys.argv[2])
sys.path[:0] = map(str, [tests.parent, tests, tests / "pipeline" / "season"])
from huggingface_hub import HfApi
from support.making import run_of
from support.policies import lay_out_released
from seasons import Performer, seed_of

folder, api = Path(sys.argv[1]), HfApi()
perform = Performer(folder, run_of)
policy = lay_out_released(folder / "policy")
api.create_repo("user/planner")

def upload():
    return api.upload_folder(repo_id="user/planner", folder_path=policy).oid

first = upload()
perform("season")
print(perform("judge", submission="user/planner@main"))
weights = policy / "model.safetensors"
weights.write_bytes(weights.read_bytes()[:-1] + b"!")
second = upload()
assert first != second
print(perform("judge", submission="user/planner@main"))
perform("reveal")
judged = perform.place.judged
judged.write_text(judged.read_text().replace(first, second))
perform("verify")
print(" ".join(perform.printed.split()))
"""


@pytest.mark.slow
def test_a_submission_on_the_hub_is_pinned_by_its_commit(local_hub, tmp_path):
    tests = Path(__file__).parents[2]
    said = run_script(local_hub, ON_THE_HUB, tmp_path, tests, token="write").stdout.splitlines()
    assert re.search(rf"user/planner@main is judged: {FIGURES}, in ", said[0])
    assert "As the best of 2 is chosen, its figures may be 0.147 too high." in said[1]
    told = "| no: user/planner@main: model.safetensors differs from the named revision: it is"
    assert (said[2].count("| yes |"), said[2].count(told)) == (1, 1)
    assert said[2].endswith("1 of its claims cannot be confirmed")


@pytest.mark.slow  # 3 s: a season, judged and verified.
def test_a_judge_says_whether_a_submission_remembers_the_train_that_it_has_learnt_from(
    tmp_path, make_run, monkeypatch
):
    monkeypatch.setattr(judge, "CONTROLS", 10)
    perform = Performer(tmp_path, make_run)
    perform("season")
    for name, options in {"own": {}, "other": {"size": "4"}, "many": {"labyrinths": 100}}.items():
        given = {"size": "3", "labyrinths": 16, "random_steps": 1} | options
        build.run(make_run(tmp_path / name, stages=["build"], **given))

    def judged_after(place, **options):
        return perform("judge", learnt_from=str(tmp_path / place), **options)

    assert "season.learnt_from: 4x4 is not 3x3" in judged_after("other/4x4")
    assert "give at most 50%" in judged_after("many/3x3")
    assert not perform.place.judged.exists()
    said = judged_after("own/3x3")
    assert "Does the policy follow its own train? test, 10 controls" in said
    assert "e.g. in" not in said, "it would name a labyrinth of the test"
    assert "is judged again, with the same bytes" in judged_after("own/3x3")
    assert "with other results or another season.learnt_from" in perform("judge")
    perform("reveal")
    path = perform.place.public / "results" / "1.json"
    receipt = Results.load(path).memorised
    assert (receipt.train["seed"], receipt.train["labyrinths"], receipt.drawn) == (0, 16, 10)
    assert "| yes |" in perform("verify")
