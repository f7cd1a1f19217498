"""Results over seeds beside the figures of the paper, not all of which are possible."""

from __future__ import annotations

import csv
import io
import json
import re
import runpy
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.evaluation.baselines import compare
from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
from labyrinth_core.evaluation.references import REFERENCES, TrainMemory
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS, score
from pipeline.machinery.evaluation_file import check_evaluation
from pipeline.machinery.schema import read_json
from pipeline.studies.results import stage as results
from pipeline.studies.results.evaluations import read, read_all, summarise
from pipeline.studies.results.paper import METHODS, paper_figures
from pipeline.studies.results.result_tables import MARK, write_tables
from pipeline.training.evaluate import as_text, describe

PAPER = paper_figures()

complete = runpy.run_path(str(Path(__file__).parents[3] / "scripts/add_references.py"))["complete"]


def test_the_paper_has_six_methods_on_five_splits_at_three_sizes():
    sizes = ("3x3", "4x4", "5x5")
    assert set(PAPER) == {
        (size, split, method) for size in sizes for split in EVALUATED_SPLITS for method in METHODS
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


def test_most_rows_at_5x5_imply_that_a_solved_labyrinth_returns_one():
    implied = [
        (figure.aer - (1 - figure.sr) * -4) / figure.sr
        for (size, split, _), figure in PAPER.items()
        if size == "5x5" and split in ("validation", "test", "s0") and figure.sr
    ]
    assert sum(abs(each - 1) < 0.001 for each in implied) > len(implied) / 2
    # More than the shortest way pays, which the success rates on s0 are high enough to tell.
    assert PAPER["5x5", "s0", "bc"].greatest_return == pytest.approx(0.984)
    assert not any(PAPER["5x5", "s0", method].is_possible for method in ("bc", "dagger", "iupe"))


def test_most_of_table_4_fits_32_labyrinths_and_not_100():
    table = [figure for figure in PAPER.values() if figure.size == 4]
    impossible = [figure for figure in table if not figure.is_possible]
    assert len(impossible) > len(table) / 2

    def fits(figure):
        sr = round(figure.sr * 32) / 32
        return figure.aer <= sr * figure.greatest_return + (1 - sr) * -4 + 0.005

    assert sum(map(fits, impossible)) > len(impossible) / 2


def test_a_figure_of_nothing_solved_is_possible():
    figure = PAPER["5x5", "s0_and_g", "bc"]
    assert figure.sr == 0
    assert figure.is_possible


class Chance:
    """A policy that is optimal except in a share of the states."""

    def __init__(self, arrays, seed):
        rng = np.random.default_rng(seed)
        best = np.eye(4)[arrays.optimal.argmax(axis=1)]
        scores = np.where(rng.random(len(best))[:, None] < 0.2, rng.random((len(best), 4)), best)
        self.scores = {
            each.tobytes(): row for each, row in zip(arrays.observations, scores, strict=True)
        }

    def __call__(self, observations):
        return np.stack([self.scores[each.tobytes()] for each in observations])


@pytest.fixture(scope="module")
def evaluated(small_dataset, tmp_path_factory):
    """Evaluations of two methods with two seeds, as the stage `evaluate` leaves them."""
    run_dir = tmp_path_factory.mktemp("runs")
    arrays = {
        split: load_arrays(small_dataset.data_dir, "3x3", split, image_size=16)
        for split in EVALUATED_SPLITS
    }
    memory, baselines, known = TrainMemory.of(arrays["train"]), {}, {}
    for split in EVALUATED_SPLITS:
        known[split], references = memory.figures(arrays[split])
        baselines[split] = compare(arrays["train"], arrays[split]) | references
    for method, seed in (("bc", 0), ("bc", 1), ("mine", 0)):
        scores = {
            split: replace(
                score(Chance(arrays[split], seed), arrays[split]), known_route=known[split]
            )
            for split in EVALUATED_SPLITS
        }
        record = {
            "run": {
                "method": method,
                "encoder": "cnn",
                "pool_stride": 1,
                "protocol": "default",
                "seed": seed,
                "config": "3x3",
                "fingerprint": "0" * 64,
                "settings": {"epochs": 7},
            },
            "epochs": 7,
            "seconds": 90.0,
            "selected": {"epoch": 5},
            "computed": {"device": "cpu"},
        }
        folder = run_dir / "3x3" / f"{method}-cnn-seed{seed}"
        folder.mkdir(parents=True)
        text = as_text(describe(record, scores, baselines, {"device": "cpu"}))
        (folder / "evaluation.json").write_text(text, encoding="utf-8")
    return run_dir


@pytest.fixture
def run_of(make_run, tmp_path):
    def make(run_dir):
        folders = {"run_dir": str(run_dir), "results_dir": str(tmp_path / "results")}
        return make_run(tmp_path / "data", stages=["results"], **folders)

    return make


def test_the_file_of_an_evaluation_is_json_with_a_line_for_each_split(evaluated):
    text = (evaluated / "3x3" / "bc-cnn-seed0" / "evaluation.json").read_text(encoding="utf-8")
    assert as_text(json.loads(text)) == text
    assert all(
        sum(f'"{split}": ' in line for line in text.splitlines()) == 2 for split in EVALUATED_SPLITS
    )
    assert len(text) < 10_000


def test_runs_in_another_precision_are_of_another_setup(evaluated, tmp_path):
    path, other = evaluated / "3x3" / "bc-cnn-seed0" / "evaluation.json", tmp_path / "bf16.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    content["run"]["precision"] = "bf16"
    other.write_text(json.dumps(content), encoding="utf-8")
    assert (read(path).setup, read(other).setup) == ("cnn", "cnn-bf16")


def test_figures_over_seeds_are_the_means_of_the_seeds(evaluated):
    runs = [read(path) for path in sorted(evaluated.glob("*/bc-*/evaluation.json"))]
    told = {figures.split: figures for figures in summarise(runs)}
    for split in EVALUATED_SPLITS:
        each = [run.content["splits"][split] for run in runs]
        assert told[split].seeds == 2
        assert told[split].sr == pytest.approx(np.mean([figures["sr"] for figures in each]))
        assert told[split].aer == pytest.approx(np.mean([figures["aer"] for figures in each]))
        assert sum(told[split].failures.values()) == pytest.approx(1 - told[split].sr)
        low, high = told[split].sr_interval
        assert low <= told[split].sr <= high


def test_the_stage_keeps_the_runs_and_writes_tables_beside_the_paper(evaluated, run_of, capsys):
    run = run_of(evaluated)
    results.run(run)
    assert "mine" in capsys.readouterr().out
    folder = Path(run.options.results_dir)
    kept = sorted(path.name for path in (folder / "runs" / "3x3").iterdir())
    assert kept == ["bc-cnn-seed0.json", "bc-cnn-seed1.json", "mine-cnn-seed0.json"]
    text = (folder / "README.md").read_text(encoding="utf-8")
    assert "| train | SR | paper | 53.1 | 65.6 | 59.4 " + MARK in text
    assert "| oracle | route memory | local walls |\n" in text
    assert "| split |  |  | BC | DAgger | GAIL | BCO | SQIL | IUPE | mine |" in text
    figures = {(each.method, each.split): each for each in summarise(read_all(folder))}
    ours = figures["bc", "test"]
    low, high = ours.sr_interval
    assert f"| test | SR | here | {100 * ours.sr:.1f} [{100 * low:.1f}, {100 * high:.1f}]" in text
    with (folder / "results.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(io.StringIO(file.read())))
    assert sum(row["source"] == "paper" for row in rows) == len(PAPER)
    found = [
        row
        for row in rows
        if (row["method"], row["split"], row["source"]) == ("bc", "test", "here")
    ]
    assert float(found[0]["sr"]) == pytest.approx(ours.sr)
    tex = (folder / "results.tex").read_text(encoding="utf-8")
    assert tex.count(r"\begin{tabular}") == tex.count(r"\end{tabular}") == 1
    assert "_" not in tex.replace(r"\_", "")
    for line in tex.splitlines():
        if line.endswith(r"\\"):
            assert line.count("&") == 9


def test_the_tables_are_made_of_the_kept_runs_alone_and_stay_the_same(evaluated, run_of, tmp_path):
    run = run_of(evaluated)
    results.run(run)
    folder = Path(run.options.results_dir)
    names = ("README.md", "results.csv", "results.tex")
    before = [(folder / name).read_bytes() for name in names]
    results.run(run_of(tmp_path / "nothing there"))
    assert [(folder / name).read_bytes() for name in names] == before


def test_without_evaluations_or_with_bad_ones_there_is_one_clear_line(evaluated, run_of, tmp_path):
    with pytest.raises(DatasetError, match=r"holds no evaluation, .* stages=\[train,evaluate\]"):
        results.run(run_of(tmp_path / "nothing there"))
    runs = shutil.copytree(evaluated, tmp_path / "runs")
    path = runs / "3x3" / "mine-cnn-seed0" / "evaluation.json"
    text = path.read_text(encoding="utf-8")
    for damaged in (
        text[:100],
        "[]",
        text.replace('"format": 1', '"format": 2'),
        text.replace('"outcomes": "', '"outcomes": "?'),
        text.replace('"outcomes": "', '"outcomes": "s'),
        text.replace('"config": "3x3"', '"config": "three"'),
    ):
        path.write_text(damaged, encoding="utf-8")
        with pytest.raises(DatasetError, match=r"evaluation\.json cannot be read: ") as error:
            results.run(run_of(runs))
        assert "\n" not in str(error.value)
    path.write_text(text.replace("0" * 64, "1" * 64), encoding="utf-8")
    with pytest.raises(DatasetError, match="are of different datasets"):
        results.run(run_of(runs))


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("run", "method"), r"\input{/etc/passwd}"),
        (("run", "encoder"), "<script>alert(1)</script>"),
        (("run", "protocol"), "a|b"),
        (("run", "config"), "3x3\n# Mine"),
        (("run", "settings"), []),
        (("training", "seconds"), float("inf")),
        (("training", "computed", "device"), {}),
        (("splits", "train", "moves", 0), 10**400),
        (("splits", "train", "moves", 0), -1),
        (("splits", "train", "sr_interval"), [0.5]),
        (("splits", "train", "path_efficiency"), 1.5),
        (("splits", "train", "failed"), [{}]),
        (("splits", "train", "by_distance"), {}),
        (("splits", "train", "spl"), 2),
        (("splits", "train", "sr_new_route"), "none"),
        (("splits", "train", "known_route"), "01"),
        (("splits", "train", "known_route"), "<b>"),
        (("splits",), {}),
        (("baselines",), {}),
        (("baselines", "test", "oracle", "aer"), float("nan")),
        (("baselines", "test", "route_memory"), {}),
        (("baselines", "test", "stranger"), {}),
        (("baselines", "test", "random", "spl"), -0.1),
    ],
)
def test_an_evaluation_that_is_none_is_refused_in_one_line(evaluated, tmp_path, place, value):
    content = json.loads((evaluated / "3x3" / "mine-cnn-seed0" / "evaluation.json").read_bytes())
    *path, last = place
    inner = content
    for name in path:
        inner = inner[name]
    inner[last] = value
    file = tmp_path / "evaluation.json"
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(DatasetError, match=r"\A.*evaluation\.json cannot be read: .+\Z"):
        read(file)


def older_content(path):
    """Return the content of an evaluation, as it was before there were references."""
    content = json.loads(path.read_bytes())
    for scores in content["splits"].values():
        for name in ("sr_within_cells", "spl", "sr_known_route", "sr_new_route", "known_route"):
            del scores[name]
    for baselines in content["baselines"].values():
        for name in REFERENCES:
            del baselines[name]
        for figures in baselines.values():
            del figures["sr_within_cells"], figures["spl"]
    return content


def test_an_older_file_is_completed_from_its_outcomes_if_all_else_follows_from_them(
    evaluated, small_dataset
):
    path = evaluated / "3x3" / "mine-cnn-seed0" / "evaluation.json"
    content = older_content(path)
    complete(path, content, small_dataset.data_dir)
    assert content == json.loads(path.read_bytes())
    for place, figure in (("splits", "sr"), ("baselines", "oracle")):
        wrong = older_content(path)
        wrong[place]["test"][figure] = 0.123 if figure == "sr" else {"sr": 0.123}
        with pytest.raises(SystemExit, match=r"test: sr is 0\.123, but follows as"):
            complete(path, wrong, small_dataset.data_dir)


def test_an_older_file_gives_what_follows_from_it_and_dashes_for_the_rest(
    evaluated, run_of, tmp_path
):
    newer = {figures.split: figures for figures in summarise([read(*evaluated.glob("*/mine-*/*"))])}
    runs = shutil.copytree(evaluated, tmp_path / "runs")
    for path in runs.glob("*/*/evaluation.json"):
        path.write_text(json.dumps(older_content(path)), encoding="utf-8")
    older = {figures.split: figures for figures in summarise([read(*runs.glob("*/mine-*/*"))])}
    for split in EVALUATED_SPLITS:
        averages = newer[split].averages | {"sr_known_route": None, "sr_new_route": None}
        assert older[split].averages == pytest.approx(averages)
    assert newer["train"].averages["sr_known_route"] == newer["train"].sr
    run = run_of(runs)
    results.run(run)
    text = (Path(run.options.results_dir) / "README.md").read_text(encoding="utf-8")
    assert "| split |  | random | majority | fixed path | oracle |\n" in text
    assert "| test | SPL | - | - | - | - |\n" in text


def test_evaluations_of_other_labyrinths_are_not_averaged(evaluated, run_of, tmp_path):
    runs = shutil.copytree(evaluated, tmp_path / "runs")
    path = runs / "3x3" / "bc-cnn-seed1" / "evaluation.json"
    content = json.loads(path.read_bytes())
    content["splits"]["test"]["by_distance"] = {"99": [0, content["splits"]["test"]["labyrinths"]]}
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(DatasetError, match="are of different datasets"):
        results.run(run_of(runs))


def test_no_name_is_a_command_a_tag_or_a_formula_in_the_tables(evaluated, tmp_path):
    name = r"=\input{x}|<script>&_$%#~^*[a](b)`"
    run = read(evaluated / "3x3" / "mine-cnn-seed0" / "evaluation.json")
    runs = [replace(run, method=name, setup=name)]
    write_tables(tmp_path, runs, summarise(runs))
    text, tex = ((tmp_path / file).read_text() for file in ("README.md", "results.tex"))
    assert not re.search(r"(?<!\\)[<|]script|(?<!\\)\|<|(?<!\\)[<`*]", text.split("## 3x3")[1])
    row = next(line for line in tex.splitlines() if line.startswith("Split"))
    assert r"=\textbackslash{}input\{x\}|<script>\&\_\$\%\#\textasciitilde{}" in row
    assert row.count(" & ") == 9
    with (tmp_path / "results.csv").open(encoding="utf-8", newline="") as file:
        here = [row for row in csv.DictReader(file) if row["source"] == "here"]
    assert {row["method"] for row in here} == {row["setup"] for row in here} == {f"'{name}"}


def test_the_results_that_are_published_are_evaluations():
    ours = Path(__file__).parents[3] / "docs/results"
    paths = [path for folder in ("", "shifts/") for path in ours.glob(f"{folder}runs/*/*.json")]
    assert len(paths) > 50
    for path in paths:
        check_evaluation(read_json(path))


def test_an_evaluation_that_cannot_be_read_does_not_replace_the_one_that_is_kept(
    evaluated, run_of, tmp_path
):
    runs = shutil.copytree(evaluated, tmp_path / "runs")
    run = run_of(runs)
    results.run(run)
    kept = Path(run.options.results_dir) / "runs" / "3x3" / "mine-cnn-seed0.json"
    before = kept.read_bytes()
    path = runs / "3x3" / "mine-cnn-seed0" / "evaluation.json"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(DatasetError):
        results.run(run)
    assert kept.read_bytes() == before


def test_seeds_of_other_settings_have_no_common_mean_but_new_settings_do_no_harm(
    evaluated, run_of, tmp_path
):
    runs = shutil.copytree(evaluated, tmp_path / "runs")
    path = runs / "3x3" / "bc-cnn-seed1" / "evaluation.json"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('"epochs": 7}', '"epochs": 7, "later": 1}'), encoding="utf-8")
    results.run(run_of(runs))
    path.write_text(text.replace('"epochs": 7}', '"epochs": 8}'), encoding="utf-8")
    with pytest.raises(DatasetError, match=r"bc-cnn-seed1\.json .* epochs=8 and 7, and not to be"):
        results.run(run_of(runs))
