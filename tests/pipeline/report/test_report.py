"""The report as a file: what it says of a dataset, and what it leaves alone."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from functools import reduce
from operator import getitem

import pytest
from support.commands import run
from support.reporting import METHOD, analyse, evaluate, evaluate_own
from support.tampering import content_of, folder_behind_link

from labyrinth_core import evaluate as evaluate_policy
from labyrinth_core.data import Dataset, Manifest
from labyrinth_core.errors import DatasetError
from pipeline.inspection import routes_of, statistics_of
from pipeline.machinery import Sums
from pipeline.report.findings import read_results
from pipeline.report.report import PAGE, pack, pack_routes, page, write_report

pytestmark = pytest.mark.slow

ROOMY = 10**9


@pytest.fixture
def data_dir(small_dataset, tmp_path):
    """A copy of a small dataset, and nothing found out about it."""
    shutil.copytree(small_dataset.data_dir, tmp_path / "labyrinth")
    return tmp_path / "labyrinth"


def data_of(text: str):
    """Return the data that a page holds."""
    return json.loads(re.search(r'id="data">(.*?)</script>', text, re.DOTALL)[1])


def routes_in(dataset):
    """Return the routes of the split train."""
    (file,) = Dataset.at(dataset.folder).files("train")
    return list(routes_of(file))


def analysis_of(data_dir):
    """Return the analysis of the only dataset of a folder, None if it has none."""
    return statistics_of(data_dir, "report")[0].analysis


def test_shards_add_up_to_what_they_are_together(small_dataset):
    found = routes_in(small_dataset)
    whole, parts = pack_routes(found, ROOMY), pack_routes(found[:3], ROOMY)
    parts.extend(pack_routes(found[3:], ROOMY))
    assert parts == whole == pack(Dataset.at(small_dataset.folder), "train", ROOMY)


@pytest.mark.parametrize("limit", [0, 100, 300, 10**6])
def test_no_more_is_packed_than_there_is_room_for_and_all_is_counted(small_dataset, limit):
    found = routes_in(small_dataset)
    counts = statistics_of(small_dataset.data_dir, "report")[0].splits["train"]
    told = pack_routes(found, ROOMY).to_json(counts, limit)
    assert (told["labyrinths"], told["episodes"]) == (8, counts.episodes)
    for name in ("moves", "loops", "junctions"):
        assert told[name] == sorted(getattr(counts, name).items())
    assert told["actions"] == counts.actions.tolist()
    assert told["visits"] == counts.visits.ravel().tolist()
    assert told["shown"] == {0: 0, 100: 2, 300: 6, 10**6: 8}[limit]
    assert sum(len(column["data"]) for column in told["columns"].values()) * 3 / 4 <= limit + 30
    assert pack_routes(found, limit).to_json(counts, limit) == told


def test_the_same_dataset_gives_the_same_report(data_dir, tmp_path):
    evaluate(data_dir / "3x3", tmp_path / "runs")
    first = write_report(data_dir, tmp_path / "runs").parent
    before = content_of(first)
    shutil.rmtree(first)
    write_report(data_dir, tmp_path / "runs", workers=2)
    assert content_of(first) == before
    assert set(before) == {PAGE, Sums.FILE}


def test_the_page_asks_for_nothing_and_takes_no_text_for_markup():
    text = page([], [{"name": "</script><script>alert(1)</script>{{script}}"}])
    assert data_of(text)["results"][0]["name"] == "</script><script>alert(1)</script>{{script}}"
    assert text.count("<script") == 2
    assert not re.search(r"""(src|href)=["'](?!data:)|@import|url\(""", text)
    assert not re.search(r"innerHTML|outerHTML|insertAdjacent|document\.write|\beval\b", text)
    assert "default-src 'none'" in text
    assert "unsafe" not in text


def test_an_analysis_is_shown_as_long_as_it_is_of_this_dataset(data_dir):
    folder = data_dir / "3x3"
    assert analysis_of(data_dir) is None
    content = analyse(folder)
    found = analysis_of(data_dir)
    counts = {"equal": 1, "mirrored": 1, "symmetric": 2, "same_route": 0}
    assert found["pairs"][0]["counts"] == counts
    assert found["pairs"][0]["spread"] == "0, 4"
    (folder / Manifest.ANALYSIS).write_text(json.dumps(content | {"fingerprint": "another"}))
    assert analysis_of(data_dir) is None


def test_runs_are_shown_by_method_as_far_as_they_are_of_these_datasets(data_dir, tmp_path):
    folder, runs = data_dir / "3x3", tmp_path / "runs"
    manifest = Manifest.read(folder)
    assert read_results(runs, [Dataset.at(folder, manifest)]) == []
    failed = {seed: evaluate(folder, runs, seed) for seed in (3, 2)}
    (method,) = read_results(runs, [Dataset.at(folder, manifest)])
    assert (method["name"], method["config"]) == (METHOD, "3x3")
    told = {run["name"]: run["splits"]["test"]["failed"] for run in method["runs"]}
    assert list(told.items()) == [(f"{METHOD}-seed{seed}", failed[seed]) for seed in (2, 3)]
    for name in told:
        path = runs / "3x3" / name / "results.json"
        path.write_text(path.read_text().replace(manifest.fingerprint, "1" * 64))
    assert read_results(runs, [Dataset.at(folder, manifest)]) == []


def test_seeds_of_other_settings_are_shown_apart_and_a_copied_run_is_left_out(
    data_dir, tmp_path, capsys
):
    folder, runs = data_dir / "3x3", tmp_path / "runs"
    for seed in (0, 1):
        evaluate(folder, runs, seed)
    of_seed = [runs / "3x3" / f"{METHOD}-seed{seed}" for seed in (0, 1)]
    path = of_seed[1] / "results.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    content["run"]["settings"]["epochs"] = 99
    path.write_text(json.dumps(content), encoding="utf-8")
    shutil.copytree(of_seed[0], runs / "3x3" / "copy")
    shown = read_results(runs, [Dataset.at(folder)])
    assert [each["name"] for each in shown] == [each.name for each in of_seed]
    assert [len(each["runs"]) for each in shown] == [1, 1]
    assert "copy/results.json belongs to the run 3x3/" in capsys.readouterr().out


def test_results_on_shifts_are_shown_also_where_there_are_no_others(build, tmp_path):
    run = build(tmp_path / "labyrinth", shifts=("g",))
    results = evaluate_policy(lambda seen: [1] * len(seen), run.data_dir, "3x3", splits=["g"])
    results.save(tmp_path / "results/submissions/x.json", name="right")
    (shown,) = read_results(tmp_path, [Dataset.at(run.folder)], tmp_path / "results")
    assert shown["splits"].keys() == shown["baselines"].keys() == {"g"}


def test_a_policy_that_no_run_made_is_shown_after_them_with_the_splits_that_it_has(
    data_dir, tmp_path
):
    folder, runs = data_dir / "3x3", tmp_path / "runs"
    evaluate_own(folder, runs, "A policy of mine")
    evaluate(folder, runs)
    method, own = read_results(runs, [Dataset.at(folder)])
    assert (method["name"], own["name"]) == (METHOD, "A policy of mine")
    assert own["splits"].keys() == own["baselines"].keys() == {"test"}
    (run,) = own["runs"]
    assert run["name"] == "A policy of mine"
    assert run["splits"]["test"]["spl"] == own["splits"]["test"]["spl"]


def test_what_was_submitted_is_shown_once_and_last_and_what_is_refused_is_named(
    data_dir, tmp_path, capsys
):
    folder, runs, results = data_dir / "3x3", tmp_path / "runs", tmp_path / "results"
    evaluate_own(folder, runs, "Mine")
    evaluate_own(folder, tmp_path / "theirs", "Theirs", author="A. Nonymous")
    (results / "submissions").mkdir(parents=True)
    for name, place in {"copied": runs, "theirs": tmp_path / "theirs"}.items():
        source = place / "3x3" / "mine" / "results.json"
        shutil.copyfile(source, results / "submissions" / f"{name}.json")
    shutil.copyfile(source, results / "submissions" / ".theirs.json")  # A hidden copy.
    damaged = results / "submissions" / "damaged.json"
    damaged.write_text("{}")
    (gone := results / "submissions" / "gone.json").symlink_to("nowhere")
    shown = read_results(runs, [Dataset.at(folder)], results)
    assert [(each["name"], each["submitted"]) for each in shown] == [
        ("Mine", False),
        ("Theirs", True),
    ]
    assert shown[1]["author"] == "A. Nonymous"
    out = capsys.readouterr().out
    assert f"left out: {damaged}" in out
    assert f"left out: {gone}: a link that leads nowhere" in out


def test_a_method_is_the_mean_of_its_runs_and_fails_where_all_of_them_do(data_dir, tmp_path):
    folder, runs = data_dir / "3x3", tmp_path / "runs"
    failed = [evaluate(folder, runs, seed) for seed in (0, 1)]
    (method,) = read_results(runs, [Dataset.at(folder)])
    test = method["splits"]["test"]
    told = [run["splits"]["test"] for run in method["runs"]]
    assert test["sr"] == told[0]["sr"] == told[1]["sr"] == 0.75
    assert test["spl"] == told[0]["spl"] == 0.75  # Every solution is a shortest route.
    for figure in ("aer", "aer_std"):
        assert test[figure] == pytest.approx((told[0][figure] + told[1][figure]) / 2)
    low, high = test["sr_interval"]
    assert 0.25 <= low < 0.75 < high <= 1
    assert (test["unsolved"], test["failed"]) == (1, [failed[0][1]])
    low, high = method["splits"]["train"]["sr_interval"]
    assert 0.5 < low < high == 1


def test_results_that_are_of_fewer_labyrinths_are_refused_in_one_line(data_dir, tmp_path):
    evaluate(data_dir / "3x3", tmp_path / "runs")
    (path,) = (tmp_path / "runs").glob("*/*/results.json")
    content = json.loads(path.read_text())
    content["run"]["train_labyrinths"] = 7
    content["method"]["name"] += "-labyrinths7"
    path.write_text(json.dumps(content))
    message = r"^.*results\.json is refused: train: 8 labyrinths, but \S* has 7$"
    with pytest.raises(DatasetError, match=message):
        write_report(data_dir, tmp_path / "runs")


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("leakage", "labyrinths", "test"), float("inf")),
        (("leakage", "labyrinths"), {}),
        (("leakage", "repeated", "train"), "<b>"),
        (("leakage", "strangers", "s0"), "many"),
        (("leakage", "pairs", 0, "equal"), {"x": "y"}),
        (("leakage", "pairs", 0, "within"), {}),
        (("leakage", "pairs", 0, "second"), "| <b>"),
        (("leakage", "pairs", 0, "spread"), "<b>"),
        (("shift", "permutations"), None),
        (("shift", "measures", 0, "distance"), float("nan")),
        (("shift", "measures", 0, "p_value"), 7),
        (("shift", "measures", 0), {}),
        (("shift",), None),
        ((), "{"),
        ((), "[]"),
        ((), "[" * 100_000),
    ],
)
def test_an_analysis_that_is_none_is_named_in_one_line(data_dir, place, value):
    folder = data_dir / "3x3"
    content = analyse(folder)
    if place:
        *path, last = place
        reduce(getitem, path, content)[last] = value
    (folder / Manifest.ANALYSIS).write_text(json.dumps(content) if place else value)
    with pytest.raises(DatasetError, match=r"^.*analysis\.json cannot be read: .*writes it again$"):
        analysis_of(data_dir)


def test_a_page_that_someone_else_made_or_changed_is_refused(data_dir, tmp_path):
    page = data_dir / "report" / PAGE
    page.parent.mkdir()

    def refused(text: str) -> None:
        page.write_text(text)
        before = content_of(data_dir)
        with pytest.raises(DatasetError, match=r"index\.html: (made|damaged) or changed"):
            write_report(data_dir, tmp_path / "runs")
        assert content_of(data_dir) == before

    refused("<title>Labyrinth report</title> mine")
    page.unlink()
    write_report(data_dir, tmp_path / "runs")
    refused(page.read_text() + "mine")


def test_a_new_report_replaces_ours_and_no_other_file(data_dir, tmp_path):
    write_report(data_dir, tmp_path / "runs")
    folder = data_dir / "report"
    before = (folder / PAGE).read_bytes()
    (folder / "photo.png").write_bytes(b"mine")
    (tmp_path / "thesis.txt").write_bytes(b"mine")
    with (folder / Sums.FILE).open("a") as listed:  # A list may name anything.
        listed.write(f"{hashlib.sha256(b'mine').hexdigest()}  ../../thesis.txt\n")
    evaluate(data_dir / "3x3", tmp_path / "runs")
    with pytest.raises(DatasetError, match="SHA256SUMS is damaged: the stage that made its files"):
        write_report(data_dir, tmp_path / "runs")
    write_report(data_dir, tmp_path / "runs", overwrite=True)
    assert (folder / PAGE).read_bytes() != before
    assert (tmp_path / "thesis.txt").read_bytes() == b"mine"
    assert (folder / "photo.png").read_bytes() == b"mine"


def test_no_report_is_written_through_a_link(data_dir, tmp_path):
    elsewhere = folder_behind_link(data_dir / "report", tmp_path)
    with pytest.raises(DatasetError, match="report is a link, and nothing is written through it"):
        write_report(data_dir, tmp_path)
    assert list(elsewhere.iterdir()) == []


def test_the_stage_is_about_all_datasets_and_needs_no_size(data_dir, tmp_path):
    for named in ([], ["size=3"]):
        done = run(tmp_path, f"data_dir={data_dir}", "stages=report", *named)
        assert done.returncode == 0, done.stderr
