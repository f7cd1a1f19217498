"""Files of a season that someone has changed, and submissions that mislead the judge."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
from contextlib import contextmanager

import numpy as np
import pytest
from seasons import Performer
from support.graphs import linear
from support.policies import RELEASED, lay_out_run

from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import PolicyError
from labyrinth_core.learning import NetworkSpec, PolicySpec
from labyrinth_core.learning.spec import MapperSpec, PlannerSpec
from labyrinth_core.policies import load, opening
from pipeline.config import ConfigError
from pipeline.season import judge
from pipeline.season.judge import fetched


@pytest.fixture
def copied(hidden, tmp_path, make_run):
    """A copy of the season, judged on once and not revealed."""
    perform = Performer(tmp_path, make_run)
    shutil.copytree(hidden.place.public.parent, perform.place.public.parent)
    return perform


def edit(path, change):
    """Change the content of a JSON file by a function, which may return another content."""
    content = json.loads(path.read_text(encoding="utf-8"))
    content = change(content) or content
    path.write_text(json.dumps(content), encoding="utf-8")


def policy_in(folder):
    """Copy the released policy, so that it is another submission; return its name."""
    shutil.copytree(RELEASED, folder)
    return str(folder)


def rows_of(perform):
    return json.loads(perform.place.judged.read_text(encoding="utf-8"))["judged"]


@pytest.mark.slow
@pytest.mark.parametrize("lost", ["the last entry", "the whole list"])
def test_a_shortened_list_does_not_let_results_be_written_over(copied, lost):
    older = copied.place.judged.read_bytes()
    second = policy_in(copied.folder / "second")
    copied("judge", submission=second)
    listed, kept = rows_of(copied), copied.place.private / "2.json"
    content = kept.read_bytes()
    if lost == "the last entry":
        copied.place.judged.write_bytes(older)
    else:
        copied.place.judged.unlink()
    copied("judge", submission=policy_in(copied.folder / "third"))
    assert rows_of(copied)[:2] == listed
    assert len(rows_of(copied)) == 3
    assert kept.read_bytes() == content
    assert "is revealed: publish it" in copied("reveal")


@pytest.mark.slow
def test_a_list_that_contradicts_the_private_results_is_refused(copied):
    place, listed = copied.place, copied.place.judged.read_bytes()

    def change(content):
        content["judged"][0]["figures"]["test"]["spl"] = 0.5

    edit(place.judged, change)
    for stage in ("judge", "reveal"):
        assert "private/1.json does not hold the results that" in copied(stage)
    place.judged.write_bytes(listed)
    (place.private / "1.json").rename(place.private / "2.json")
    for stage in ("judge", "reveal"):
        assert "private/1.json does not hold the results that" in copied(stage)
    shutil.rmtree(place.private)
    for stage in ("judge", "reveal"):
        assert "private/1.json does not hold the results that" in copied(stage)


@pytest.mark.slow
def test_nothing_is_judged_or_added_after_the_reveal(copied, monkeypatch):
    place = copied.place

    @contextmanager
    def waits_for_the_reveal(*_):
        place.revealed.write_text("shown while this process waited")
        yield

    with monkeypatch.context() as patch:
        patch.setattr(judge, "held", waits_for_the_reveal)
        assert "is revealed, so nothing more can be judged on it" in copied("judge")
    place.revealed.unlink()

    assert "is revealed: publish it" in copied("reveal")
    assert "is revealed: publish it" in copied("reveal")
    secret = place.revealed.rename(copied.folder / "aside")
    copied("judge", submission=policy_in(copied.folder / "late"))
    secret.rename(place.revealed)
    assert "is revealed already, with another results/2.json" in copied("reveal")
    edit(place.judged, lambda content: {**content, "judged": content["judged"][:1]})
    assert "is revealed already, with another results/2.json" in copied("reveal")


def _in(content, name, **values):
    content[name].update(values)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.update(date="2026-02-30"), "date=2026-02-30: there is no such day"),
        (lambda s: s.update(name="2026-b"), "season.json is of the season 2026-b"),
        (lambda s: s.update(labyrinths=16), "labyrinths is 16, not an object"),
        (lambda s: s.update(labyrinths={"test": -1}), "labyrinths.test is -1, not a whole number"),
        (lambda s: s.pop("labyrinths") and None, "it has no labyrinths"),
        (lambda s: _in(s, "config", labyrinths=2 * 10**9), "labyrinths=2000000000: up to "),
        (lambda s: _in(s, "config", random_steps=10**9), "labyrinths=16: up to 16,"),
        (
            lambda s: _in(s, "config", solutions="all", solutions_limit=10**9),
            "more than the 1,000,000,000 of a season",
        ),
        (lambda s: _in(s, "config", seed=3), "its config has a seed, or options at their defaults"),
        (lambda s: _in(s, "config", goals="fixed"), "or options at their defaults"),
        (lambda s: _in(s, "config", height=10**9), "is invalid: "),
        (lambda s: _in(s, "config", labyrinths=16.0), "is invalid: "),
        (lambda s: [s], "is invalid: it is "),
        (lambda _: "[" * 100_000, "is invalid: "),
    ],
)
def test_a_season_with_impossible_fields_is_refused_before_anything_is_made(
    copied, change, message
):
    edit(copied.place.season, change)
    refused = copied("judge")
    assert message in refused
    assert "\n" not in refused


def test_files_without_end_and_large_ones_are_not_read(copied):
    for path in (copied.place.season, copied.place.judged):
        content = path.read_bytes()
        with path.open("r+b") as file:
            file.truncate((1 << 24) + 1)
        assert "16,777,217 bytes, more than 16,777,216" in copied("judge")
        if sys.platform == "linux":
            path.unlink()
            path.symlink_to("/dev/zero")
            assert "is not a regular file" in copied("judge")
            path.unlink()
            os.mkfifo(path)
            assert "is not a regular file" in copied("judge")
        path.unlink()
        path.write_bytes(content)


@pytest.mark.parametrize("labyrinths", [2 * 10**9, 10**8])
def test_a_season_that_nobody_could_verify_is_not_made(tmp_path, make_run, labyrinths):
    perform = Performer(tmp_path, make_run)
    with pytest.raises(ConfigError, match=f"labyrinths={labyrinths}: up to .* rows, more than"):
        perform("season", size="5", labyrinths=labyrinths)
    assert not perform.place.public.exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("season", lambda s: s.update(date="2026-12-24"), "so its date is not confirmed"),
        ("season", lambda s: s["labyrinths"].pop("test"), "other labyrinths than the test: test"),
        ("season", lambda s: _in(s, "labyrinths", test=0), "other labyrinths than the test: test"),
        ("season", lambda s: _in(s, "labyrinths", more=9), "other labyrinths than the test: more"),
        ("season", lambda s: s.update(shards={}), "other shards than the test: "),
        (
            "season",
            lambda s: s.update(shards=dict.fromkeys(s["shards"], "0" * 64), versions={}),
            "although the versions are equal",
        ),
        ("judged", lambda j: j.update(season="2026-b"), "it.season is '2026-b', not '2026-a'"),
        ("judged", lambda j: j.update(more=1), "it has more, which is unknown"),
        ("judged", lambda j: j.update(judged=[]), "results/1.json \\| - \\| - \\| no: not in"),
        ("judged", lambda j: j["judged"].append(j["judged"][0]), "no: it is in the list twice"),
        ("judged", lambda j: j["judged"].insert(0, None), "entry 1 \\| - \\| - \\| no: it is None"),
        (
            "judged",
            lambda j: _in(j["judged"][0], "figures", test={"spl": 2, "sr": 1}),
            "entry 1 \\| - \\| - \\| no: it.figures.test.spl is 2, not a number from 0 to 1",
        ),
        ("judged", lambda j: j["judged"][0].update(more=1), "no: it has more, which is unknown"),
        (
            "judged",
            lambda j: j["judged"][0].update(submission="a | SPL 1.00 | yes"),
            "no: the submission is 'a .\\| SPL 1.00 .\\| yes', not a text like",
        ),
        (
            "judged",
            lambda j: _in(j["judged"][0], "versions", numpy="1 | yes | \x1b[2J"),
            "| no: .*numpy 1 .\\| yes",
        ),
    ],
)
def test_a_forged_field_is_found_when_the_season_is_verified(revealed, name, change, message):
    edit(getattr(revealed.place, name), lambda content: change(content) and None)
    said = f"{revealed('verify')} {revealed.printed}"
    assert re.search(message, " ".join(said.split())), said
    assert "cannot be confirmed" in said or name == "season" or "is not a list of results" in said


@pytest.mark.slow
def test_verify_goes_on_after_what_is_wrong(revealed):
    public = revealed.place.public
    edit(revealed.place.judged, lambda j: j["judged"].insert(0, {"submission": "./random"}))
    for folder in ("results", "submissions"):
        first = next((public / folder).glob("1*"))
        first.rename(first.with_name(first.name.replace("1", "2", 1)))
    (public / "results" / "9.json").write_text("{}")
    (public / "submissions" / "7").mkdir()
    reported = public / "self-reported"
    reported.mkdir()
    (reported / "a.json").write_text("[" * 100_000)
    (reported / "b.json").mkdir()
    shutil.copyfile(public / "results" / "2.json", reported / "c.json")
    assert "5 of its claims cannot be confirmed" in revealed("verify")
    said = " ".join(revealed.printed.split())
    assert "| entry 1 | - | - | no: " in said
    assert said.count("| yes |") == 1
    assert "| results/9.json | - | - | no: not in the list |" in said
    assert "| submissions/7 | - | - | no: not in the list |" in said
    assert said.count("self-reported, and refused: ") == 2
    assert said.count("self-reported, not verified: ") == 1


@pytest.mark.parametrize(
    "named",
    [
        *(
            "./random",
            "random/",
            "Random",
            "random",
            "random@main",
            "a/../random",
            "a//b",
            "..",
            "/",
        ),
        *("a | SPL 1.00 | yes", "pl\u0430nner", "caf\u00e9", "cafe\u0301", "\uff52andom", "a\nb"),
        *(
            "a b",
            "a\u200bb",
            "a@b@c",
            "a@",
            "@a",
            "a.zip",
            "a" * 301,
            "`a`",
            "a\\b",
            "user/model@..",
        ),
    ],
)
def test_names_that_mislead_are_refused(tmp_path, make_run, named):
    perform = Performer(tmp_path, make_run)
    with pytest.raises(ConfigError, match=r"^season\.submission(=|: name=)"):
        perform("judge", submission=named)
    with pytest.raises(ValueError, match=r"submission|name="):
        judge.check_name(named)


@pytest.mark.parametrize(
    "named",
    [
        *("user/planner-5x5@1.0.0", "user/model@refs/pr/1", "runs/5x5/bc-cnn-seed0"),
        *("/a/b+c=d.onnx", f"model.onnx@{'0' * 64}", "~/runs/x", "C:/runs/x", "user/random"),
    ],
)
def test_usual_names_are_taken(named):
    judge.check_name(named)


GRAPH = "model.onnx"
POSIX = pytest.mark.skipif(os.name != "posix", reason="this system has no such files")


@pytest.mark.parametrize(
    "kind", ["folder", pytest.param("device", marks=POSIX), pytest.param("pipe", marks=POSIX)]
)
def test_what_is_no_regular_file_is_not_copied(tmp_path, kind):
    path = tmp_path / GRAPH
    if kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.mkdir()
    with pytest.raises(DatasetError, match=r"model\.onnx is not a regular file$"):
        fetched(str(tmp_path)).__enter__()


def test_a_file_that_grows_is_copied_up_to_its_limit(tmp_path, monkeypatch):
    path = tmp_path / GRAPH
    path.write_bytes(linear(np.ones((12, 4), np.float32), shape=("b", 2, 2, 3)))
    limit = {GRAPH: path.stat().st_size}
    monkeypatch.setattr(opening, "MOST_BYTES", limit)
    monkeypatch.setattr(load, "MOST_BYTES", limit)
    checked = load.check_size

    def grow(*told):
        checked(*told)
        with path.open("ab") as file:
            file.write(b"more")

    monkeypatch.setattr(opening, "check_size", grow)
    with pytest.raises(DatasetError, match=r"model\.onnx has .* bytes, more than "):
        fetched(str(tmp_path)).__enter__()


@pytest.mark.slow
def test_a_policy_of_ours_that_takes_too_long_is_refused_while_it_computes(
    tmp_path, monkeypatch, small_dataset
):
    from labyrinth_core import evaluate

    slow = PlannerSpec(False, False, False, channels=32, iterations=5, sharpness=3.0)
    spec = PolicySpec(NetworkSpec("planner", 3, 3, "navigation"), average=True, own=slow)
    lay_out_run(tmp_path / "slow", spec)
    monkeypatch.setattr(judge, "SECONDS", 0.3)
    with (
        fetched(str(tmp_path / "slow")) as given,
        pytest.raises(PolicyError, match=r"the policy takes more than 0\.3 seconds$") as refused,
    ):
        evaluate(given.policy, small_dataset.data_dir, "3x3", splits=["test"])
    assert any("_require_time" in each.name for each in refused.traceback)
    assert any("call_impl" in each.name for each in refused.traceback)  # Within the network.


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["planner", "mapper"])
def test_the_limit_of_time_changes_no_result(tmp_path, small_dataset, kind):
    from labyrinth_core import evaluate, load_policy

    folder = RELEASED
    if kind == "mapper":
        spec = PolicySpec(NetworkSpec(kind, 5, 5, "navigation"), False, MapperSpec(8, 4))
        folder = lay_out_run(tmp_path / kind, spec)
    with fetched(str(folder)) as given:
        limited, free = (
            evaluate(each, small_dataset.data_dir, "3x3", splits=["test"])
            for each in (given.policy, load_policy(folder))
        )
    assert (str(limited), limited.way) == (str(free), free.way)
