"""Results over seeds beside the figures of the paper, not all of which are possible."""

from __future__ import annotations

import io
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from support.making import perform
from support.submitted import forgetful, keep, of_run, results_of

from labyrinth_core.data import SPLITS
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Results
from labyrinth_core.storage import File
from pipeline.config import ConfigError
from pipeline.machinery import console
from pipeline.results import results as stage
from pipeline.results.leaderboard import entries_of
from pipeline.results.tables import paper_figures

PAPER = paper_figures()


def test_the_paper_has_six_methods_on_five_splits_at_three_sizes():
    sizes = ("3x3", "4x4", "5x5")
    methods = ("bc", "dagger", "gail", "bco", "sqil", "iupe")
    assert set(PAPER) == {
        (size, split, method) for size in sizes for split in SPLITS.evaluated for method in methods
    }
    # Read off the tables again, at the corners.
    assert (PAPER["3x3", "train", "bc"].aer, PAPER["3x3", "train", "bc"].sr) == (-1.36, 0.5312)
    last = PAPER["5x5", "s0", "iupe"]
    assert (last.aer, last.aer_std, last.sr) == (0, 0.8, 0.8)
    assert PAPER["4x4", "s0_and_g", "sqil"].sr == 0.21


def test_what_iupe_returns_on_train_at_5x5_cannot_be_but_would_with_the_other_sign():
    figure = PAPER["5x5", "train", "iupe"]
    assert figure.aer == 0.27
    assert not figure.is_possible
    implied = (-figure.aer - (1 - figure.sr) * -4) / figure.sr
    assert implied == pytest.approx(figure.greatest_return, abs=0.005)


@pytest.fixture(scope="module")
def evaluated(small_dataset, tmp_path_factory):
    """Results of two methods with two seeds, as the stage `evaluate` leaves them."""
    run_dir = tmp_path_factory.mktemp("runs")
    for method, seed in (("bc", 0), ("bc", 1), ("dagger", 0)):
        found = results_of(small_dataset.data_dir, "3x3", forgetful(3, 3, seed=seed))
        keep(of_run(found, method, seed), run_dir)
    return run_dir


@pytest.fixture
def run_of(make_run, small_dataset, tmp_path):
    def make(run_dir, data_dir=small_dataset.data_dir):
        folders = {"run_dir": str(run_dir), "results_dir": str(tmp_path / "results")}
        return make_run(data_dir, stages=["results"], **folders)

    return make


def of(run_dir, name):
    return Results.load(run_dir / "3x3" / name / "results.json")


def test_the_file_of_results_is_json_with_a_line_for_each_part_of_a_split(evaluated):
    path = evaluated / "3x3" / "bc-cnn-seed0" / "results.json"
    text = path.read_text(encoding="utf-8")
    assert sum('"outcomes": ' in line for line in text.splitlines()) == len(SPLITS.evaluated)
    assert len(text) < 20_000


def test_figures_over_seeds_are_the_means_of_the_seeds(evaluated):
    runs = [of(evaluated, f"bc-cnn-seed{seed}") for seed in (0, 1)]
    for split in SPLITS.evaluated:
        figures, each = Results.over_seeds(runs, split), [run.splits[split] for run in runs]
        for name in ("spl", "sr", "sr_within_cells", "aer"):
            mean = np.mean([getattr(scores, name) for scores in each])
            assert figures[name] == pytest.approx(mean)
        failed = sum(figures[name] for name in ("loop", "wall", "ice"))
        assert failed == pytest.approx(1 - figures["sr"])
        assert figures["sr_low"] <= figures["sr"] <= figures["sr_high"]
        counts = re.findall(r": (\d+) of (\d+)", figures["by_distance"])
        assert sum(int(won) for won, _ in counts) == round(16 * figures["sr"])
        assert sum(int(count) for _, count in counts) == 16


def test_a_mean_over_seeds_is_rounded_once_so_that_no_version_of_python_changes_it(evaluated):
    # Built-in `sum` is compensated from Python 3.12 on; ten times 0.1 then has another last digit.
    found = of(evaluated, "bc-cnn-seed0")
    test = replace(found.splits["test"], accuracy_elsewhere=0.1)
    runs = [replace(found, splits={"test": test})] * 10
    assert Results.over_seeds(runs, "test")["accuracy_elsewhere"] == 0.1


@pytest.mark.slow
def test_the_tables_are_made_of_the_kept_runs_alone(
    evaluated, run_of, tmp_path, capsys, monkeypatch
):
    folder = tmp_path / "results"
    tables = ("README.md", "results.csv", "leaderboard.md", "leaderboard.csv")
    monkeypatch.setattr(console, "_said", set())
    perform("results", run_of(evaluated))
    printed = capsys.readouterr().out
    assert "DAgger" in printed
    assert "success weighted by path length" in printed
    kept = sorted(path.name for path in (folder / "runs" / "3x3").iterdir())
    assert kept == ["bc-cnn-seed0.json", "bc-cnn-seed1.json", "dagger-cnn-seed0.json"]
    before = [(folder / name).read_bytes() for name in tables]
    perform("results", run_of(tmp_path / "nothing there"))
    assert "success weighted" not in capsys.readouterr().out, "the legend is printed once"
    assert [(folder / name).read_bytes() for name in tables] == before
    for path in (folder / "runs" / "3x3").iterdir():
        path.write_text("{}", encoding="utf-8")
    with pytest.raises(DatasetError):
        perform("results", run_of(tmp_path / "nothing there"))
    assert ",here," not in (folder / "results.csv").read_text(encoding="utf-8")


def test_on_a_terminal_of_80_columns_no_name_of_a_split_or_a_method_is_cut(evaluated):
    found = of(evaluated, "bc-cnn-seed0")
    long = replace(found.run, encoder="resnet18", protocol="authors", train_labyrinths=100)
    methods = entries_of([found, replace(found, run=long)])
    console = Console(file=io.StringIO(), width=80)
    console.print(stage.overview(methods))
    printed = console.file.getvalue()
    assert "\u2026" not in printed
    assert max(map(len, printed.splitlines())) <= 80
    heading = next(line for line in printed.splitlines() if "s0_and_g" in line)
    assert heading.replace("\u2503", " ").split() == ["method", "seeds", *SPLITS.evaluated]
    rows = [line.split("\u2502")[1].strip() for line in printed.splitlines() if "\u2502" in line]
    assert "".join(rows).replace(" ", "") == f"BC,cnnBC,{long.setup}".replace(" ", "")


@pytest.mark.slow
def test_a_table_of_a_person_is_not_written_over(evaluated, run_of, tmp_path):
    path = tmp_path / "results" / "leaderboard.md"
    path.parent.mkdir()
    path.write_text("mine")
    for _ in range(2):
        with pytest.raises(DatasetError, match="made or changed by someone else") as error:
            perform("results", run_of(evaluated))
        assert "\n" not in str(error.value)
        assert path.read_text() == "mine"
        assert not path.with_name("results.csv").exists()


@pytest.mark.slow
def test_a_kept_file_of_somebody_else_is_not_replaced_by_a_copy_of_the_same_name(
    evaluated, run_of, tmp_path
):
    perform("results", run_of(evaluated))
    kept = min((tmp_path / "results" / "runs" / "3x3").glob("*.json"))
    theirs = kept.read_text(encoding="utf-8").replace('"seconds": ', '"seconds": 1')
    kept.write_text(theirs, encoding="utf-8")
    with pytest.raises(DatasetError, match=f"{kept} was made or changed by someone else"):
        perform("results", run_of(evaluated))
    assert kept.read_text(encoding="utf-8") == theirs


def test_a_folder_in_the_place_of_a_file_of_results_is_named(evaluated, run_of, tmp_path):
    for name in ("runs/3x3/x.json", "submissions/3x3/y.json"):
        (tmp_path / "results" / name).mkdir(parents=True)
    with pytest.raises(DatasetError) as refused:
        perform("results", run_of(evaluated))
    assert "2 files not on the leaderboard" in str(refused.value)
    for name in ("x", "y"):
        assert f"3x3/{name}.json is refused: it is not a file" in str(refused.value)


def test_without_results_there_is_one_clear_line(run_of, tmp_path):
    with pytest.raises(DatasetError, match=r"holds no results, .* 'stages=\[train,evaluate\]'"):
        perform("results", run_of(tmp_path / "nothing there"))


@pytest.mark.slow
def test_a_folder_with_a_revision_is_refused_before_anything_is_copied(evaluated, run_of, tmp_path):
    run = run_of(evaluated)
    options = replace(run.options, dataset=str(tmp_path), revision="1.0.0")
    with pytest.raises(ConfigError, match=r"\Arevision=1\.0\.0: .*\Z"):
        perform("results", replace(run, options=options))
    assert not (tmp_path / "results").exists()


@pytest.mark.slow
def test_a_dataset_that_is_named_and_has_no_results_gets_a_line_with_those_that_have(
    evaluated, run_of, tmp_path
):
    run = run_of(evaluated)
    other = replace(run, dataset=replace(run.dataset, height=4), names_dataset=True)
    with pytest.raises(DatasetError, match=r"\Athere are no results on 4x3: .* are on 3x3; .*\Z"):
        perform("results", other)
    assert not (tmp_path / "results").exists()


def test_a_run_that_does_not_add_up_is_left_out_and_does_not_replace_the_one_that_is_kept(
    evaluated, run_of, tmp_path
):
    runs = shutil.copytree(evaluated, tmp_path / "runs")
    run = run_of(runs)
    perform("results", run)
    folder = Path(run.options.results_dir)
    before = (folder / "README.md").read_bytes()
    path = runs / "3x3" / "dagger-cnn-seed0" / "results.json"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('"format": 2', '"format": 3', 1), encoding="utf-8")
    with pytest.raises(DatasetError) as error:
        perform("results", run)
    first, second = str(error.value).splitlines()
    assert first == "1 file not on the leaderboard:"
    assert second == f"  {path} is refused: it.format is 3, not 2"
    assert (folder / "README.md").read_bytes() == before


@pytest.mark.slow
def test_runs_are_compared_with_the_dataset_that_is_available_if_it_is_theirs(
    evaluated, run_of, build, tmp_path, capsys
):
    perform("results", run_of(evaluated))
    board = tmp_path / "results" / "leaderboard.csv"
    assert ",True,train," in board.read_text()
    other = build(tmp_path / "other", seed=7)
    perform("results", run_of(evaluated, other.data_dir))
    assert f"{other.data_dir}/3x3 is another dataset" in capsys.readouterr().out
    assert ",True,train," not in board.read_text()


def test_runs_of_equal_weights_are_named(evaluated, run_of, tmp_path, capsys):
    runs = tmp_path / "runs"
    for seed, weights in enumerate(("a" * 64, "b" * 64, "a" * 64, None, None)):
        found = of(evaluated, "bc-cnn-seed0")
        made = replace(found.run, seed=seed, evaluated=found.run.evaluated | {"weights": weights})
        keep(replace(found, seed=seed, run=made), runs)
    perform("results", run_of(runs))
    told = [line for line in capsys.readouterr().out.splitlines() if "Equal weights" in line]
    names = "3x3/bc-cnn-seed0.json, 3x3/bc-cnn-seed2.json"
    assert told == [f"Equal weights, so one policy that counts 2 times: {names}"]


@pytest.mark.slow
def test_runs_on_other_labyrinths_are_not_compared(evaluated, run_of, tmp_path):
    runs = shutil.copytree(evaluated, tmp_path / "runs")
    found = of(runs, "dagger-cnn-seed0")
    other = replace(found.run, method="gail", fingerprint="1" * 64)
    keep(replace(found, fingerprint="1" * 64, run=other), runs)
    with pytest.raises(DatasetError, match="are of different datasets"):
        perform("results", run_of(runs, tmp_path / "no data"))


@pytest.mark.slow
def test_seeds_of_other_settings_have_no_common_mean_but_new_settings_do_no_harm(
    evaluated, run_of, tmp_path
):
    runs = shutil.copytree(evaluated, tmp_path / "runs")
    found = of(runs, "bc-cnn-seed1")

    def with_settings(**settings):
        keep(replace(found, run=replace(found.run, settings=settings)), runs)

    with_settings(epochs=7, later=1)
    perform("results", run_of(runs))
    with_settings(epochs=8)
    with pytest.raises(DatasetError, match=r"bc-cnn-seed1\.json .* epochs=8 and 7, so they cannot"):
        perform("results", run_of(runs))


@pytest.mark.slow
def test_the_results_that_are_published_add_up():
    ours = Path(__file__).parents[3] / "docs/results"
    # Those of `runs` itself are read for the leaderboard that is published; of the finished
    # studies the first of each folder, which one commit wrote and none changes.
    folders = {path.parent for path in ours.glob("*/**/runs/*/*.json")}
    assert len(folders) > 10
    for path in (min(folder.glob("*.json")) for folder in folders):
        content = File(path).read_json()
        if content["run"].get("memory"):  # Of runs that only an earlier commit knows.
            del content["run"]
        results = Results.from_json(content)
        assert results.method.name == path.stem
