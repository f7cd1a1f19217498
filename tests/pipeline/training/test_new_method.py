"""The method that docs/new-method.md shows works as it says."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from pathlib import Path

import pytest
import yaml

import pipeline.training.methods
from pipeline.config.errors import ConfigError
from pipeline.config.run import Run, RunConfig, resolve
from pipeline.training import train
from pipeline.training.methods.method import find

pytestmark = pytest.mark.slow

DOCUMENT = (Path(__file__).parents[3] / "docs" / "new-method.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    found = re.search(rf"```{language}\n(.*?)```", DOCUMENT, re.DOTALL)
    assert found is not None
    return found[1]


def test_the_example_is_trained_as_any_other_method(
    tmp_path: Path, small_dataset: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = block("python")
    assert len(source.splitlines()) < 60
    (tmp_path / "smoothed.py").write_text(source)
    path = [*pipeline.training.methods.__path__, str(tmp_path)]
    monkeypatch.setattr(pipeline.training.methods, "__path__", path)
    settings = yaml.safe_load(block("yaml"))
    _, chosen = find("smoothed", {name: settings[name] for name in settings if name != "name"})
    assert settings == {"name": "smoothed"} | asdict(chosen)
    with pytest.raises(ConfigError, match=r"^method\.epochs is missing"):
        find("smoothed", {})
    run = resolve(
        RunConfig(
            stages=["train"],
            size="3",
            data_dir=str(small_dataset.data_dir),
            run_dir=str(tmp_path / "runs"),
            method=settings | {"epochs": 8, "batch_size": 8},
            encoder="mlp",
            observation="vector",
        )
    )
    train.run(run, checkpoint_seconds=0)  # So that its state is kept, too.
    record = json.loads((tmp_path / "runs/3x3/smoothed-mlp-seed0/run.json").read_text())
    losses = [row["loss"] for row in record["history"]]
    assert losses[-1] < losses[0]
    assert record["history"][-1]["visited"] > 0
