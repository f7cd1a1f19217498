"""The queue of runs: each is one that the program makes, and what is kept is not repeated."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import run_queue as queue
from support.making import composed

from pipeline.training.identity import find


@pytest.mark.slow  # Hydra composes some sixty command lines.
def test_each_run_leaves_its_results_where_the_queue_looks_for_them() -> None:
    # The seeds of a method differ in their number alone.
    one_of_each = {each.kept.rpartition("-seed")[0]: each for each in queue.planned()}
    assert len(one_of_each) > 15
    for each in one_of_each.values():
        *builds, train, evaluate = (name for name in each.commands() if "try_authors" not in name)
        (program, *own, stage), (_, *same, then) = (
            shlex.split(each.partition(" evaluate_on=")[0]) for each in (train, evaluate)
        )
        assert (queue.ROOT / program).exists()
        assert (own, stage, then) == (same, "stages=train", "stages=evaluate")
        run = composed(*own, "stages=[train,evaluate]", *re.findall("evaluate_on=.*", evaluate))
        find(run.options.method_name, run.options.method, run.options.protocol)
        assert (run.training_folder.parent, run.training_folder.name) == (
            Path("runs", each.folder),
            Path(each.kept).stem,
        )
        assert run.options.evaluate_on == each.evaluate_on
        folders = [options.rpartition("data_dir=")[2].split()[0] for options in builds]
        assert Path(each.evaluate_on).parent.as_posix() in (folders[-1], ".")


def test_each_run_trains_and_is_evaluated_at_least_once() -> None:
    for each in queue.planned():
        counts = re.findall(r"method\.(?:epochs|evaluate_every)=(\S+)", each.options)
        assert all(int(count) > 0 for count in counts), each.kept


def test_what_is_kept_is_not_repeated_and_all_hours_are_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = queue.Planned("runs/3x3/mine-cnn-seed0.json", 1.0, "size=3", "method=bc")
    done: list[str] = []

    def program(options: str) -> None:
        done.append(options)
        if "stages=evaluate" in options:
            if len(done) == 3:
                raise SystemExit(143)  # As after SIGTERM.
            left = tmp_path / "runs/runs/3x3/mine-cnn-seed0/results.json"
            left.parent.mkdir(parents=True)
            left.write_text("{}")

    monkeypatch.setattr(queue, "program", program)
    monkeypatch.setattr(queue, "ROOT", tmp_path)
    monkeypatch.setattr(queue, "planned", lambda: iter([run]))
    with pytest.raises(SystemExit):
        queue.perform(run, tmp_path)
    assert queue.missing_in(tmp_path) == [run]
    queue.perform(run, tmp_path)
    assert queue.missing_in(tmp_path) == []
    assert (tmp_path / run.kept).read_text() == "{}"
    logged = [line.split(",")[0] for line in (tmp_path / queue.HOURS).read_text().splitlines()]
    assert logged == [run.kept, run.kept]
