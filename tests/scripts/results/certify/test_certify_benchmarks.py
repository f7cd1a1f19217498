"""The certificates of benchmarks.md: each is of the list, and none is made twice."""

from __future__ import annotations

from pathlib import Path

import certify_benchmarks as study
import gymnasium
import numpy as np
import pytest
import report_benchmarks as report
from environments.generated import TEST, map_of

from labyrinth_core.storage import File

KEPT = sorted(study.KEPT.glob("*.json"))


def test_every_kept_certificate_is_of_the_list_or_of_records() -> None:
    planned = {each.name: each for each in study.benchmarks()}
    assert len(planned) > 25
    for path in KEPT:
        arguments = File(path).read_json()["arguments"]
        if arguments["environment"] == f"{path.stem}.jsonl":
            continue
        benchmark = planned[path.stem]
        assert arguments == {
            "environment": benchmark.environment,
            "train": f"{benchmark.train.start}:{benchmark.train.stop}",
            "test": f"{benchmark.test.start}:{benchmark.test.stop}",
            "probes": benchmark.probes,
            "steps": benchmark.steps,
        }


@pytest.mark.slow
def test_what_is_kept_is_not_certified_again_and_a_failure_stops_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = [
        study.Benchmark("Missing-v0", "gymnasium"),
        study.Benchmark("other", "no_such_package"),
        study.Benchmark(
            "environments.generated:FrozenLake4x4-v0",
            "gymnasium",
            train=range(3),
            test=range(TEST, TEST + 3),
            probes=1,
            steps=2,
            state=map_of,
        ),
    ]
    monkeypatch.setattr(study, "benchmarks", lambda: iter(chosen))
    for again in range(2):
        monkeypatch.setattr("sys.argv", ["certify_benchmarks.py", "--kept", str(tmp_path)])
        study.main()
        printed = capsys.readouterr().out
        assert "Missing-v0: " in printed
        assert "other: left out, no_such_package is not installed" in printed
        assert ("3 train seeds" in printed) == (again == 0)
    assert (tmp_path / study.SECONDS).read_text().startswith("FrozenLake4x4-v0,")
    kept = File(tmp_path / "FrozenLake4x4-v0.json").read_json()
    assert kept["measures"]["state"]["of"] == 3
    records = tmp_path / "records"
    records.mkdir()
    rows = [f'{{"split": "{split}", "seed": 1, "first": "a"}}' for split in ("train", "test")]
    (records / "game.jsonl").write_text("\n".join(rows))
    arguments = ["certify_benchmarks.py", "--kept", str(tmp_path), "--records", str(records)]
    monkeypatch.setattr("sys.argv", arguments)
    study.main()
    assert File(tmp_path / "game.json").read_json()["measures"]["first"]["count"] == 1


def test_a_seed_chooses_the_map_and_the_split() -> None:
    lake = gymnasium.make("environments.generated:FrozenLake4x4-v0")
    maps = []
    for seed in (1, 2, 1):
        lake.reset(seed=seed)
        maps.append(map_of(lake))
    assert np.array_equal(maps[0], maps[2])
    assert not np.array_equal(maps[0], maps[1])
    env = gymnasium.make("environments.generated:TwoSplits3x3-v0").unwrapped
    for seed, split in ((5, "train"), (TEST, "test"), (6, "train")):
        env.reset(seed=seed)
        assert {source.split for source in env._sources} == {split}


def test_a_row_has_the_figures_of_a_certificate_and_a_refused_measure_has_no_share() -> None:
    kept = report.kept()[0]
    kept["reasons"]["first"] = "it reads a clock"
    del kept["measures"]["first"]
    cells = report.row(kept)
    assert cells[report.HEADING.index("first")] == "no share"
    assert cells[report.HEADING.index("at least")] == f"{kept['levels']['at_least']:,}"


def test_published_seeds_are_in_a_table_of_their_own() -> None:
    published, own = report.published(), report.certified()
    row = "| VAGEN-FrozenLake | 10,000 | 256 | 9,469 | 13.8 | 86,276 | 32 | 12.5 [9.0, 17.1] |"
    assert row in published.splitlines()
    assert "VAGEN" not in own
    assert "| OpenEnv-Maze | 1 | 100 | 1 |" in own
    for each in study.benchmarks():
        if each.environment.startswith((study.GENERATED, study.ELSEWHERE)):
            assert gymnasium.spec(each.name)


def test_procgen_has_a_row_for_each_game_and_view() -> None:
    rows = report.procgen().splitlines()
    assert len(rows) == 2 + 16
    assert rows[2] == "| maze | 3.0 [1.8, 4.9] | 1.8 [0.9, 3.4] |"
    assert len(report.procgen_views().splitlines()) == 2 + 10


def test_the_page_and_the_readme_lead_with_the_number_of_a_certificate() -> None:
    kept = File(study.KEPT / "MiniGrid-LavaCrossingS9N2-v0.json").read_json()
    share = round(100 * kept["measures"]["state"]["share"])
    page, readme = (
        (study.KEPT.parents[2] / name).read_text(encoding="utf-8")
        for name in ("docs/studies/benchmarks.md", "README.md")
    )
    assert f"Of 500 test seeds of MiniGrid's LavaCrossingS9N2, {share}% give" in page
    assert f"LavaCrossingS9N2 give {share}% of test's levels" in readme
