"""The stage `environments`: complete, resumable, the same bytes, one line for a mistake."""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.world.labyrinth import Task
from pipeline.config.analysis import AnalysisOptions
from pipeline.config.errors import ConfigError
from pipeline.config.run import Run, RunConfig, resolve
from pipeline.studies.environments import compare as environments
from pipeline.studies.environments.summaries import Summary

pytestmark = pytest.mark.slow

REPORT = {
    *("environments.json", "environments.csv", "environments.md", "visits.png", "visits.svg"),
    "SHA256SUMS",
}


def run_of(folder: Path, *names: str, seeds: int = 8, **options: Any) -> Run:
    analysis = AnalysisOptions(
        seeds=seeds,
        environments=list(names) or ["Labyrinth", "MountainCar-v0"],
        experts=options.pop("experts", []),
        folder=str(folder),
    )
    config = RunConfig(
        stages=["environments"], data_dir="unused", size="3", analysis=analysis, **options
    )
    return resolve(config)


def report_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def compare(run: Run) -> None:
    """Run the stage with few episodes at a time."""
    environments.run(run, chunk=4, pilots=4)


@pytest.fixture
def played(monkeypatch):
    """Return the list of all ranges of seeds that are played from now on."""
    ranges: list[range] = []
    play = Summary.of

    def recorded(environment, discretisation, seeds):
        ranges.append(seeds)
        return play(environment, discretisation, seeds)

    monkeypatch.setattr(Summary, "of", recorded)
    return ranges


def test_a_run_leaves_tables_in_three_formats_and_pictures_in_two(tmp_path, capsys):
    compare(run_of(tmp_path, "Labyrinth", "MountainCar-v0", "CartPole-v1", seeds=9))
    assert set(report_of(tmp_path)) == REPORT
    values = json.loads((tmp_path / "environments.json").read_text())
    assert [each["name"] for each in values] == ["Labyrinth", "MountainCar-v0", "CartPole-v1"]
    assert all(each["seeds"] == 9 for each in values)
    assert values[2]["average_reward"] == 500
    assert values[2]["original"]["trajectory_difference"] == 0.0037
    rows = list(csv.DictReader((tmp_path / "environments.csv").read_text().splitlines()))
    assert float(rows[1]["states.p_value"]) == values[1]["states"]["p_value"]
    text = (tmp_path / "environments.md").read_text()
    assert "| CartPole-v1 | 500.0000 (500.0000) |" in text
    assert "Manhattan distance" in text
    assert (tmp_path / "visits.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (tmp_path / "visits.svg").read_bytes()
    assert "9 episodes" in capsys.readouterr().out


def test_only_what_is_new_or_was_damaged_is_played_and_the_bytes_are_those_of_one_run(
    tmp_path, played
):
    compare(run_of(tmp_path, "MountainCar-v0"))
    first = report_of(tmp_path)
    assert played == [range(4), range(4, 8)]
    (kept,) = tmp_path.glob("episodes/MountainCar-v0-*/0-4.npz")
    kept.write_bytes(b"PK")
    played.clear()
    compare(run_of(tmp_path, "MountainCar-v0"))
    assert played == [range(4)]
    assert report_of(tmp_path) == first
    played.clear()
    compare(run_of(tmp_path, "MountainCar-v0", seeds=10))
    assert played == [range(8, 10)]
    compare(run_of(tmp_path / "afresh", "MountainCar-v0", seeds=10))
    assert report_of(tmp_path / "afresh") == report_of(tmp_path)


def test_episodes_of_other_options_are_played_anew_and_nothing_is_removed(tmp_path, played):
    mine = tmp_path / "episodes" / "Labyrinth" / "notes.txt"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    compare(run_of(tmp_path, "Labyrinth"))
    played.clear()
    compare(run_of(tmp_path, "Labyrinth", open_walls=0.5))
    assert played == [range(4), range(4, 8)]
    played.clear()
    compare(run_of(tmp_path, "Labyrinth"))
    assert (played, mine.read_text()) == ([], "mine")


@pytest.mark.parametrize(
    ("name", "value"), [("__version__", "0.0.1"), ("version", lambda library: f"old {library}")]
)
def test_episodes_of_another_version_are_played_anew(tmp_path, played, monkeypatch, name, value):
    with monkeypatch.context() as other:
        other.setattr(environments, name, value)
        compare(run_of(tmp_path, "Labyrinth"))
    played.clear()
    compare(run_of(tmp_path, "Labyrinth"))
    assert played == [range(4), range(4, 8)]


def test_a_table_of_a_person_is_not_written_over(tmp_path):
    (tmp_path / "environments.md").write_text("mine")
    with pytest.raises(DatasetError, match=r"environments\.md: made or changed by somebody else"):
        compare(run_of(tmp_path, "Labyrinth"))
    assert report_of(tmp_path) == {"environments.md": b"mine"}


def test_two_workers_leave_the_bytes_of_one(tmp_path):
    for workers in (1, 2):
        compare(run_of(tmp_path / str(workers), "Labyrinth", seeds=12, workers=workers))
    assert report_of(tmp_path / "1") == report_of(tmp_path / "2")


@pytest.mark.parametrize(
    ("library", "name"), [("mujoco", "Hopper-v5"), ("matplotlib", "Labyrinth")]
)
def test_a_missing_library_is_named_with_its_extra_in_one_line(
    tmp_path, monkeypatch, library, name
):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ConfigError) as caught:
        compare(run_of(tmp_path, name))
    assert "pip install 'labyrinth-datasets[analysis]'" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not any(tmp_path.iterdir())


def test_what_cannot_be_played_is_refused_in_one_line_before_anything_is_played(tmp_path):
    absent = run_of(tmp_path, "CartPole-v1", experts=[f"CartPole-v1:{tmp_path / 'no.zip'}"])
    tiny = run_of(tmp_path, "Labyrinth")
    tiny = replace(tiny, dataset=replace(tiny.dataset, height=2, width=2, task=Task.ICY_FLOOR))
    for run, reason in ((absent, r"no\.zip"), (tiny, r"size=2x2.*can hold it")):
        with pytest.raises((ConfigError, DatasetError), match=reason):
            compare(run)
        assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        ({"environments": ["Ant-v5"]}, ["analysis.environments=[Ant-v5]", "HalfCheetah-v5"]),
        ({"environments": []}, ["analysis.environments=[]", "HalfCheetah-v5"]),
        ({"seeds": 3}, ["analysis.seeds=3", "4 to"]),
        ({"experts": ["Ant-v5:a.zip"]}, ["analysis.experts=[Ant-v5:a.zip]", "HalfCheetah-v5"]),
        ({"experts": ["Labyrinth:a.zip"]}, ["analysis.experts=[Labyrinth:a.zip]"]),
        ({"experts": ["Hopper-v5"]}, ["analysis.experts=[Hopper-v5]", "environment:archive"]),
        ({"folder": " "}, ["analysis.folder=", "give a folder"]),
    ],
)
def test_an_impossible_option_is_refused_in_one_line(options, parts):
    with pytest.raises(ConfigError) as caught:
        resolve(
            RunConfig(
                stages=["environments"], data_dir="unused", analysis=AnalysisOptions(**options)
            )
        )
    assert all(part in str(caught.value) for part in parts)
    assert "\n" not in str(caught.value)
