"""Datasets from elsewhere that cannot be read: one line says why."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.making import Run

from labyrinth_core.errors import DatasetError
from pipeline.certify.stage import read_elsewhere

READ = """
import sys
from labyrinth_core.errors import DatasetError
from pipeline.certify.stage import read_elsewhere
try:
    read_elsewhere(sys.argv[1], "3x3")
except DatasetError as error:
    print(error)
"""


def test_a_card_that_is_no_yaml_is_answered_with_one_line(
    small_dataset: Run, tmp_path: Path
) -> None:
    folder = shutil.copytree(small_dataset.data_dir, tmp_path / "labyrinth")
    (folder / "README.md").write_text("---\nconfigs: [a: b: c\n---\n", encoding="utf-8")
    with pytest.raises(DatasetError, match=r"README\.md: its front matter cannot .*line 2: "):
        read_elsewhere(str(folder), "3x3")


def test_the_folder_one_is_in_is_read(small_dataset: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(small_dataset.data_dir / "3x3")
    assert read_elsewhere(".", None).splits["train"]


def test_a_config_that_is_not_there_is_answered_with_those_that_are(small_dataset: Run) -> None:
    source = str(small_dataset.data_dir)
    with pytest.raises(DatasetError) as caught:
        read_elsewhere(source, "9x9")
    there = f"{source}: BuilderConfig '9x9' not found. Available: ['3x3', "
    assert str(caught.value).startswith(there)


@pytest.mark.parametrize(("config", "said"), [(None, ["default config 3x3"]), ("3x3", [])])
def test_a_config_that_the_dataset_chooses_is_told(
    both: Path, capsys: pytest.CaptureFixture[str], config: str | None, said: list[str]
) -> None:
    assert read_elsewhere(str(both), config).config == "3x3"
    printed = capsys.readouterr().out
    assert [line.split("; ")[0] for line in printed.splitlines()] == [f"{both}: {s}" for s in said]


@pytest.mark.slow
def test_a_cache_that_cannot_be_written_is_not_taken_for_a_folder_that_is_not_there(
    small_dataset: Run,
) -> None:
    source = str(small_dataset.data_dir)
    offline = {"HF_HOME": "/proc/cache", "HF_DATASETS_CACHE": "/proc/cache", "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", READ, source],
        env=os.environ | offline,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.startswith(f"{source}: the cache of the Hub's client cannot be used (HF_HO")
    assert "/proc/cache" in done.stdout
    assert done.stdout.count("\n") == 1
