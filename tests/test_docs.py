"""What the documents say is what the code does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from labyrinth_core import __version__
from labyrinth_core.data.columns import COLUMNS, SPLITS
from labyrinth_core.language.text import dump, parse
from labyrinth_core.world.labyrinth import Task
from pipeline.config.run import OPTIONS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])


def table(heading: str) -> dict[str, str]:
    """Return the rows of the README's table whose first heading is given, by first column."""
    lines = README.split(f"| {heading} | ", 1)[1].splitlines()[2:]
    rows = {}
    for line in lines:
        if not line.startswith("| "):
            break
        name, meaning = line.strip("| ").split(" | ", 1)
        rows[name.strip("`")] = meaning
    return rows


def test_the_readme_explains_every_option_as_the_help_text_does():
    assert table("option") == OPTIONS


def test_the_readme_explains_every_column():
    assert table("column") == {column.name: column.meaning for column in COLUMNS}


def test_the_readme_explains_every_split():
    assert table("split") == SPLITS


def test_the_readme_explains_every_task():
    assert list(table("task")) == [str(task) for task in Task]


def test_the_example_of_the_language_is_canonical():
    example = "key_and_lock" + README.split("```\nkey_and_lock", 1)[1].split("```", 1)[0]
    assert dump(parse(example)) == example


def test_the_check_runs_the_test_command_of_the_readme():
    command = re.search(r"^pip install -c .*$", README, re.MULTILINE)
    assert command is not None
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert command[0].replace("pip install", "pip install -q") in script


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_link_to_a_file_leads_to_one(document):
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", document.read_text(encoding="utf-8"))
    assert all((document.parent / link).exists() for link in links), links


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_python_block_is_python(document):
    blocks = re.findall(r"```python\n(.*?)```", document.read_text(encoding="utf-8"), re.DOTALL)
    for block in blocks:
        compile(block, document.name, "exec")


def test_the_version_is_the_same_everywhere():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == __version__
    assert f"## {__version__}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
