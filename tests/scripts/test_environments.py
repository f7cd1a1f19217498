"""The comparison of environments: complete, resumable, and the same bytes with two workers."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import compare_environments as environments
import pytest
from environments.summaries import Summary
from support.making import run_of

from labyrinth_core.world import LabyrinthError

pytestmark = pytest.mark.slow

REPORT = {"environments.json", "environments.csv", "environments.md", "visits.png", "visits.svg"}


def compare(folder: Path, *names: str, seeds: int = 8, workers: int = 1, **options: Any) -> None:
    """Compare environments with few episodes at a time."""
    dataset = run_of(folder, **{"labyrinths": None} | options).dataset
    environments.compare(
        folder, list(names), dataset, seeds=seeds, workers=workers, chunk=4, pilots=4
    )


def report_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


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
    compare(tmp_path, "Labyrinth", "MountainCar-v0", "CartPole-v1", seeds=9)
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
    compare(tmp_path, "MountainCar-v0")
    first = report_of(tmp_path)
    assert played == [range(4), range(4, 8)]
    (kept,) = tmp_path.glob("episodes/MountainCar-v0-*/0-4.npz")
    kept.write_bytes(b"PK")
    played.clear()
    compare(tmp_path, "MountainCar-v0")
    assert played == [range(4)]
    assert report_of(tmp_path) == first
    played.clear()
    compare(tmp_path, "MountainCar-v0", seeds=10)
    assert played == [range(8, 10)]
    compare(tmp_path / "afresh", "MountainCar-v0", seeds=10)
    assert report_of(tmp_path / "afresh") == report_of(tmp_path)


def test_episodes_of_other_options_are_played_anew_and_nothing_is_removed(tmp_path, played):
    mine = tmp_path / "episodes" / "Labyrinth" / "notes.txt"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    compare(tmp_path, "Labyrinth")
    played.clear()
    compare(tmp_path, "Labyrinth", open_walls=0.5)
    assert played == [range(4), range(4, 8)]
    played.clear()
    compare(tmp_path, "Labyrinth")
    assert (played, mine.read_text()) == ([], "mine")


@pytest.mark.parametrize(
    ("name", "value"), [("__version__", "0.0.1"), ("version", lambda library: f"old {library}")]
)
def test_episodes_of_an_earlier_version_are_played_anew(tmp_path, played, monkeypatch, name, value):
    with monkeypatch.context() as earlier:
        earlier.setattr(environments, name, value)
        compare(tmp_path, "Labyrinth")
    played.clear()
    compare(tmp_path, "Labyrinth")
    assert played == [range(4), range(4, 8)]


def test_two_workers_leave_the_bytes_of_one(tmp_path):
    for workers in (1, 2):
        compare(tmp_path / str(workers), "Labyrinth", seeds=12, workers=workers)
    assert report_of(tmp_path / "1") == report_of(tmp_path / "2")


def test_labyrinths_that_cannot_hold_the_task_are_refused_before_anything_is_played(tmp_path):
    with pytest.raises(LabyrinthError, match=r"size=2x2.*random labyrinths fits"):
        compare(tmp_path, "MountainCar-v0", "Labyrinth", size="2", task="icy_floor")
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
