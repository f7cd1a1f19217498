"""The recipes that need no other library run, and come to what they should.

`scripts/check_clients.py` runs the others.
"""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

from labyrinth_core.data import SPLITS
from labyrinth_core.evaluation import Results

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[1] / "examples"
RECIPES = sorted(EXAMPLES.glob("*.py"))


def run(name: str, **arguments: object) -> Results:
    """Return what the function `main` of a recipe returns."""
    results = runpy.run_path(str(EXAMPLES / f"{name}.py"))["main"](**arguments)
    assert isinstance(results, Results)
    return results


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda path: path.stem)
def test_a_recipe_is_short_and_stands_by_itself(recipe):
    text = recipe.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 60
    assert "pipeline" not in text


def test_plain_pytorch_learns_its_demonstrations(small_dataset):
    results = run("plain_pytorch", folder=small_dataset.data_dir, config="3x3", epochs=100)
    assert tuple(results.splits) == SPLITS.evaluated
    assert results.splits["train"].sr == 1


def test_a_recurrent_policy_learns_its_demonstrations(datasets):
    config = "3x4-partial_observability"
    results = run("recurrent_policy", folder=str(datasets), config=config, epochs=50)
    assert results.way == "steps"
    assert results.splits["train"].sr >= 0.8
