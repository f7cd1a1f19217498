"""The leaderboard: the figures are those of `evaluate`, ranks claim no more than intervals do."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from support.commands import RUN, ended
from support.making import perform
from support.policies import Rounds
from support.quick_python import python
from support.submitted import content_of, forgetful, keep, of_run, results_of

from labyrinth_core import memorised
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Description, Results
from labyrinth_core.evaluation.scores import Scores, interval
from pipeline.results.leaderboard import Entry, boards, leaderboard

ROOT = Path(__file__).parents[3]
PUBLISHED = ROOT / "docs" / "results"


@pytest.fixture(scope="module")
def results(small_dataset):
    """Of two policies: one by look-ups, one in two episodes."""
    folder = small_dataset.data_dir
    return {
        "planner": results_of(folder, "3x3", forgetful(3, 3)),
        "rounds": results_of(folder, "3x3", Rounds(2), episodes=2),
    }


@pytest.fixture
def run_of(make_run, small_dataset, tmp_path):
    """A function that returns a run of the stage."""

    def make(data_dir=small_dataset.data_dir, **options):
        folders = {"run_dir": str(tmp_path / "runs"), "results_dir": str(tmp_path / "results")}
        return make_run(data_dir, stages=["results"], **(folders | options))

    return make


@pytest.fixture
def submit(tmp_path):
    """A function that puts a file where anybody's results lie."""

    def write(content, name="mine.json"):
        path = tmp_path / "results" / "submissions" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content), encoding="utf-8")
        return path

    return write


def rows(folder):
    with (folder / "leaderboard.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def text(folder):
    return (folder / "leaderboard.md").read_text(encoding="utf-8")


def test_receipts_have_a_column_where_a_policy_has_one(
    results, small_dataset, run_of, submit, tmp_path
):
    policy = forgetful(3, 3)
    receipt = memorised(policy, small_dataset.data_dir, "3x3", observation="vector", controls=10)
    submit(content_of(results["planner"], "plain"), "plain.json")
    perform("results", run_of())
    assert "follows its own train" not in text(tmp_path / "results")
    submit(content_of(replace(results["planner"], memorised=receipt), "asked"), "asked.json")
    perform("results", run_of())
    column = f" {receipt.excess:+.2f} (p {receipt.p:.3f}) |"
    lines = [line for line in text(tmp_path / "results").splitlines() if line.endswith(column)]
    assert [line.split("|")[1].strip() for line in lines] == ["asked"]
    assert "follows its own train" in text(tmp_path / "results")


def test_a_strangers_method_stands_there_under_its_own_name_without_an_author(
    results, run_of, tmp_path
):
    for method, encoder in (("mine", "cnn"), ("Linear", "Linear")):
        keep(of_run(results["planner"], method, encoder=encoder), tmp_path / "runs")
    perform("results", run_of())
    named = {(row["method"], row["author"]) for row in rows(tmp_path / "results")}
    assert named == {("mine, cnn", ""), ("Linear", "")}  # Nobody says who made them.
    assert "Labyrinth datasets" not in text(tmp_path / "results")


def test_the_figures_of_the_leaderboard_are_those_of_evaluate_to_the_digit(
    results, run_of, submit, tmp_path
):
    for name, each in results.items():
        submit(content_of(each, name, details={"steps": 12}), f"{name}.json")
    perform("results", run_of())
    found = {(row["method"], row["split"]): row for row in rows(tmp_path / "results")}
    assert len(found) == 2 * 5
    for name, each in results.items():
        for split, scores in each.splits.items():
            row, figures = found[name, split], scores.figures()
            for figure in ("labyrinths", *scores.summary(), "path_efficiency"):
                assert row[figure] == ("" if figures[figure] is None else str(figures[figure]))
            figures["spl_interval"] = interval(Scores.by_labyrinth(scores.weighted)[None])
            for figure in ("spl", "sr", "aer"):
                bounds = [row[f"{figure}_low"], row[f"{figure}_high"]]
                assert bounds == [str(bound) for bound in figures[f"{figure}_interval"]]
            assert row["fingerprint"] == each.fingerprint
            assert (row["train_steps"], row["parameters"]) == ("12", "")
            assert row["compared"] == "True"
        scores = each.splits["test"]
        low, high = interval(Scores.by_labyrinth(scores.weighted)[None])
        cells = f"| {100 * scores.spl:.1f} [{100 * low:.1f}, {100 * high:.1f}] |"
        assert re.search(rf"\| {name} {re.escape(cells)}", text(tmp_path / "results"))
    assert Results.WHY_SPL in text(tmp_path / "results")


def refused_by(run):
    """Return the lines on the refused files: the name of each, and why."""
    with pytest.raises(DatasetError) as error:
        perform("results", run)
    _, *lines = str(error.value).splitlines()
    found = (re.fullmatch(r"  \S*/(\S+)\.json is refused: (.*)", line) for line in lines)
    return {each[1]: each[2] for each in found}


@pytest.mark.slow
def test_a_name_of_ours_or_of_another_submission_is_refused(results, run_of, submit, tmp_path):
    run = of_run(results["planner"])
    run.save(tmp_path / "results" / "runs" / "3x3" / "bc-cnn-seed0.json", name=run.run.name)
    submit(content_of(results["planner"], "Mine"), "a.json")
    taken = r"\S*%s\.json has the same name, %s, on the same dataset"
    reasons = {
        "b1": ({"name": "bc, CNN"}, taken % ("bc-cnn-seed0", "BC, cnn")),
        "b2": ({"name": "BC-cnn-seed0 "}, taken % ("bc-cnn-seed0", "bc-cnn-seed0")),
        "b3": ({"name": " dagger"}, "name= dagger is reserved for runs"),
        "b4": ({"name": "m\uff49ne "}, taken % ("a", "Mine")),
        "b5": ({"author": "labyrinth  DATASETS"}, "author=Labyrinth datasets is reserved for runs"),
    }
    for name, (about, _) in reasons.items():
        submit(content_of(results["rounds"], **{"name": "other", **about}), f"{name}.json")
    (tmp_path / "results" / "submissions" / "gone.json").symlink_to("nowhere")
    reasons["gone"] = ({}, "a link that leads nowhere: .*")
    refused = refused_by(run_of())
    assert refused.keys() == reasons.keys()
    for name, (_, why) in reasons.items():
        assert re.fullmatch(why, refused[name])
    assert {row["method"] for row in rows(tmp_path / "results")} == {"BC, cnn", "Mine"}


@pytest.mark.slow
def test_a_run_is_of_a_known_kind_and_lies_in_its_own_place(results, run_of, tmp_path):
    own = "it belongs to the run 3x3/bc-cnn-seed0, not to this one"
    reasons = {
        "3x3/bc-cnn-seed1": ({}, own),
        "5x5/bc-cnn-seed2": ({}, own),
        "3x3/bc-vit-seed0": ({"encoder": "vit"}, r"encoder=vit: choose from cnn, .*"),
        "3x3/bc-cnn-seed0-mine": ({"protocol": "mine"}, "protocol=mine: choose from default, .*"),
        "3x3/bc-mlp-seed0": (
            {"encoder": "mlp"},
            "observation=image: encoder=mlp looks at vector",
        ),
        "3x3/bc-cnn-seed0": ({"fingerprint": "1" * 64}, "its policy learnt from another data.*"),
    }
    for where, (changed, _) in reasons.items():
        run = of_run(results["planner"], **changed)
        run.save(tmp_path / "results" / "runs" / f"{where}.json", name=run.run.name)
    refused = refused_by(run_of())
    assert len(refused) == len(reasons)
    for where, (_, why) in reasons.items():
        assert re.fullmatch(why, refused[where.partition("/")[2]])
    assert rows(tmp_path / "results") == []


def test_where_the_dataset_is_not_available_results_are_marked_and_each_dataset_has_its_board(
    results, run_of, submit, tmp_path, capsys
):
    submit(content_of(results["planner"], "planner"), "a.json")
    other = content_of(results["planner"], "planner")
    other["dataset"]["fingerprint"] = "1" * 64
    submit(other, "b.json")
    elsewhere = tmp_path / "nothing"
    perform("results", run_of(elsewhere))
    line = f"3x3 is not available, so results on it have no rank: {elsewhere}/3x3"
    assert f"{line} holds no dataset" in capsys.readouterr().out
    assert text(tmp_path / "results").count("\n## 3x3\n") == 2
    assert "\n|  | planner † |" in text(tmp_path / "results")
    assert {row["compared"] for row in rows(tmp_path / "results")} == {"False"}
    with pytest.raises(DatasetError, match=r"b\.json is refused: it is of another dataset than"):
        perform("results", run_of())
    assert "\n| 1 | planner |" in text(tmp_path / "results")


def test_results_of_policies_that_the_program_evaluated_are_kept(results, run_of, tmp_path):
    folder = tmp_path / "runs" / "3x3" / "my-policy"
    results["planner"].save(folder / "results.json", name="my policy")
    perform("results", run_of())
    kept = tmp_path / "results" / "submissions" / "3x3" / "my-policy.json"
    assert kept.read_bytes() == (folder / "results.json").read_bytes()
    assert {row["method"] for row in rows(tmp_path / "results")} == {"my policy"}
    before = text(tmp_path / "results")
    (folder / "results.json").write_text("{")
    with pytest.raises(DatasetError, match=r"my-policy/results\.json is refused: "):
        perform("results", run_of())
    assert text(tmp_path / "results") == before


def test_a_hidden_copy_of_results_is_not_ranked_in_place_of_the_file(
    results, run_of, submit, tmp_path
):
    submit(content_of(results["rounds"], "mine"), ".ipynb_checkpoints/mine-checkpoint.json")
    submit(content_of(results["planner"], "mine"), "mine.json")
    perform("results", run_of())
    assert "\n| 1 | mine |" in text(tmp_path / "results")
    alone = rows(tmp_path / "results")
    shutil.rmtree(tmp_path / "results" / "submissions" / ".ipynb_checkpoints")
    perform("results", run_of())
    assert rows(tmp_path / "results") == alone


@pytest.mark.slow
def test_the_command_of_the_page_ends_with_1_for_refused_files_and_ranks_the_others(
    results, small_dataset, submit, tmp_path
):
    page = (ROOT / "docs" / "evaluation.md").read_text(encoding="utf-8")
    section = page.split("## Leaderboard\n")[1].split("\n## ")[0]
    command, replay = re.findall(r"```sh\npython run\.py (.*)\n```", section)
    assert replay == f"{command} results.replay=true"
    shutil.copytree(small_dataset.data_dir, tmp_path / "data" / "labyrinth")
    content = content_of(results["planner"], "planner")
    submit(content, "a.json")
    submit(content_of(results["rounds"], "planner"), "again.json")
    told = content["splits"]["test"]
    told["moves"][0][told["outcomes"][0].index("s")] = 3
    submit(content, "5x5/forged.json")
    done = ended([python(), str(RUN), command], cwd=tmp_path)
    assert (done.returncode, done.stdout) == (1, "1 method: results/leaderboard.md\n")
    first, second, third = done.stderr.splitlines()
    assert first == "error: 2 files not on the leaderboard:"
    reason = r"test: moves\[0\]\[\d\] is 3: .* has a solution of fewer moves than a shortest route"
    assert re.fullmatch(rf"  results/submissions/5x5/forged\.json is refused: {reason}", second)
    assert third == (
        "  results/submissions/again.json is refused: results/submissions/a.json has the same "
        "name, planner, on the same dataset"
    )
    assert {row["method"] for row in rows(tmp_path / "results")} == {"planner"}


# Ranks and names.


@pytest.fixture(scope="module")
def entry(results):
    """A function that returns an entry with some SPL on test."""

    def make(name, spl=None, low=0.0, high=1.0, *, compared=True, **changed):
        about = {"config": "5x5", "fingerprint": "0" * 64, **changed}
        shown = [replace(results["planner"], **about)]
        figures = Results.over_seeds(shown, "test") | {"spl": spl, "spl_low": low, "spl_high": high}
        held = {} if spl is None else {"test": figures}
        return Entry(shown, Description(name), held, compared)

    return make


def test_a_rank_counts_the_methods_whose_interval_lies_wholly_above(entry):
    entries = [
        entry("none"),
        entry("low", 0.1, 0.05, 0.2),
        entry("middle", 0.45, 0.4, 0.5),
        entry("beside", 0.40, 0.35, 0.45),
        entry("equal", 0.45, 0.4, 0.5),
        entry("best", 1.0, 1.0, 1.0),
        entry("not compared", 1.0, 1.0, 1.0, compared=False),
        entry("failing", 0.0, 0.0, 0.04),
    ]
    for [board] in (boards(entries), boards(reversed(entries))):
        assert [(each.rank, each.about.name) for each in board] == [
            (1, "best"),
            (2, "equal"),
            (2, "middle"),
            (2, "beside"),
            (5, "low"),
            (None, "not compared"),
            (None, "failing"),
            (None, "none"),
        ]


def test_of_methods_that_solve_nothing_none_is_first(entry):
    [board] = boards([entry("a", 0.0, 0.0, 0.04), entry("b", 0.0, 0.0, 0.04)])
    assert [each.rank for each in board] == [None, None]
    page = leaderboard([board])["leaderboard.md"]
    assert "\n|  | a | 0.0 [0.0, 4.0] |" in page


def test_the_leaderboard_begins_with_the_ranks(entry):
    page = leaderboard(boards([entry("a", 0.5)]))["leaderboard.md"]
    title, heading, *lines = filter(None, page.splitlines())
    table = "| rank | method | SPL | SR | n | outcomes |"
    assert (title, heading, lines[0]) == ("# Leaderboard", "## 5x5", table)
    assert page.index("## How to read it") > page.index("fingerprint is")


def test_every_config_and_dataset_has_a_board_of_its_own_the_smallest_first(entry):
    entries = [
        entry("a", config="10x10"),
        entry("b", config="5x5", fingerprint="1" * 64),
        entry("c", config="5x5"),
        entry("d", config="5x5-icy_floor"),
    ]
    assert [each[0].about.name for each in boards(entries)] == ["c", "b", "d", "a"]


def test_no_name_is_markup_a_link_or_a_formula(entry):
    name = "=1|<script>[a](javascript:b)`*"
    url = "https://a.org/(b)[c]|<d>"
    about = Description(name, author="@me|", url=url, budget="+1<b>", details={"steps": 5})
    shown = replace(entry("x", -0.5), about=about)
    page, table = leaderboard([[shown]]).values()
    told = page.partition("## 5x5")[2].partition("The dataset's fingerprint")[0]
    assert not re.search(r"(?<!\\)[<`*]", told)
    link = r"[=1\|\<script\>\[a\](javascript:b)\`\*](https://a.org/%28b%29%5Bc%5D%7C%3Cd%3E)"
    assert link in told
    for lines in re.findall(r"(?:^\|.*\n?)+", told, re.MULTILINE):
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in lines.splitlines()}) == 1
    [row] = csv.DictReader(table.splitlines())
    assert (row["method"], row["author"], row["budget"]) == (f"'{name}", "'@me|", "'+1<b>")
    assert row["spl"] == "-0.5"


# What is published.


@pytest.mark.slow
def test_the_leaderboard_that_is_published_is_made_of_the_runs_that_are(run_of, build, tmp_path):
    for size, labyrinths in (("3", 32), ("4", 100), ("5", 100)):
        build(tmp_path / "labyrinth", size=size, labyrinths=labyrinths)
    folder = tmp_path / "results"
    shutil.copytree(PUBLISHED / "runs", folder / "runs")
    perform("results", run_of(tmp_path / "labyrinth"))
    for name in ("leaderboard.md", "leaderboard.csv", "README.md", "results.csv"):
        made, published = (
            (each / name).read_text(encoding="utf-8") for each in (folder, PUBLISHED)
        )
        assert made == published, name
