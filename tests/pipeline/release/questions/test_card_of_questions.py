"""Questions on the card of their dataset, and in its verification."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from support.asking import NAME, OPTIONS, SHIFTS, SPLITS, TEST, asked, copied
from support.making import perform

from labyrinth_core.questions import QUESTION_COLUMNS
from pipeline.release import card
from pipeline.release.verify import verify

__all__ = ["asked", "copied"]

pytestmark = pytest.mark.slow


def listed_splits(readme: Path) -> list[str] | None:
    """Return the splits of the questions in a front matter, None if it does not list them."""
    configs = yaml.safe_load(readme.read_text().split("---\n")[1])["configs"]
    found = {each["config_name"]: [f["split"] for f in each["data_files"]] for each in configs}
    return found.get(f"{NAME}-questions")


def test_the_card_lists_the_questions_until_the_dataset_has_other_rows(copied, build, capsys):
    card.run(copied)
    readme = copied.data_dir / "README.md"
    assert all(f"| `{column.name}` |" in readme.read_text() for column in QUESTION_COLUMNS)
    assert f"{NAME}-questions/{TEST}" in (copied.data_dir / "SHA256SUMS").read_text()
    described = json.loads((copied.data_dir / "croissant.json").read_text())
    *_, records = described["recordSet"]
    assert [field["name"] for field in records["field"]][1:] == [c.name for c in QUESTION_COLUMNS]
    assert {part["@id"] for part in described["distribution"]} >= {f"{NAME}-questions/{TEST}"}
    benchmark = yaml.safe_load((copied.data_dir / "eval.yaml").read_text())
    assert benchmark["evaluation_framework"] == "inspect-ai"
    assert {task["id"] for task in benchmark["tasks"]} == {
        f"{NAME}-questions{form}-{split}" for form in ("", "-pictures") for split in SPLITS
    }
    more = OPTIONS | {"shifts": (*SHIFTS, "thin_walls")}
    build(copied.data_dir, labyrinths=4, grow=True, **more)
    assert listed_splits(readme) == SPLITS
    assert "no longer lists" not in capsys.readouterr().out
    build(copied.data_dir, labyrinths=5, grow=True, **more)
    assert listed_splits(readme) is None
    assert f"no longer lists {NAME}-questions: " in capsys.readouterr().out
    grown = replace(copied, dataset=replace(copied.dataset, labyrinths=5))
    perform("questions", grown)
    assert f"{NAME}-questions" in readme.read_text().split("---\n")[1]


def test_a_verification_loads_the_questions(asked):
    assert verify(str(asked.data_dir), None, asked.data_dir) == "every config loads"
