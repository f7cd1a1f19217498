"""What the documents say is what the code does."""

from __future__ import annotations

import os
import pkgutil
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

import labyrinth_core
from labyrinth_core import __version__
from labyrinth_core.language import dump, parse
from labyrinth_core.world import Task

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
CURRENT = [path for path in DOCUMENTS if path.name != "CHANGELOG.md"]
"""The documents that say what is; the changelog names what was, too."""
OURS = ("labyrinth_core", "pipeline", "conf", "scripts", "tests", "docs", "examples", ".ci")


def blocks(document: Path) -> list[str]:
    """Return the Python programs of a document."""
    return re.findall(r"```python\n(.*?)```", document.read_text(encoding="utf-8"), re.DOTALL)


FOR_READERS = [document for document in DOCUMENTS if document.name != "new-method.md"]
"""All that do not extend the program; tests/pipeline/training/test_new_method.py has that one."""


def table(heading: str, text: str) -> dict[str, str]:
    """Return the rows of a text's table whose first heading is given, by first column."""
    lines = text.split(f"| {heading} | ", 1)[1].splitlines()[2:]
    rows = {}
    for line in lines:
        if not line.startswith("| "):
            break
        name, meaning = line.strip("| ").split(" | ", 1)
        rows[name.strip("`")] = meaning
    return rows


def test_the_guide_explains_every_task():
    text = (ROOT / "docs" / "make.md").read_text(encoding="utf-8")
    assert list(table("task", text)) == [str(task) for task in Task]


def test_the_reference_has_every_public_name_of_the_library():
    text = (ROOT / "docs" / "reference" / "library.md").read_text(encoding="utf-8")
    named = re.findall(r"^::: labyrinth_core\.(\w+)$", text, re.MULTILINE)
    assert sorted(named) == sorted(labyrinth_core.__all__)


def test_the_reference_has_a_page_for_every_folder_of_the_library():
    site = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for module in pkgutil.iter_modules(labyrinth_core.__path__):
        if not module.ispkg or module.name == "command":  # The command has its `--help`.
            continue
        page = ROOT / "docs" / "reference" / f"{module.name}.md"
        assert f"<!-- modules of labyrinth_core/{module.name} -->" in page.read_text("utf-8")
        assert f" reference/{page.name}\n" in site


def test_every_extra_is_explained():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = (ROOT / "docs" / "get-started.md").read_text(encoding="utf-8")
    assert table("extra", text).keys() == project["optional-dependencies"].keys()


def test_the_readme_has_no_more_than_550_words():
    assert len(README.split()) <= 550


CARD = ROOT.glob("pipeline/release/texts/dataset.md")  # A wing, which may be taken out.


@pytest.mark.parametrize("path", [ROOT / "README.md", *CARD], ids=lambda path: path.stem)
def test_the_first_paragraph_of_a_page_has_the_numbers_of_the_results(path):
    text = (ROOT / "docs" / "studies" / "results.md").read_text(encoding="utf-8")
    rows = table("5x5 | seeds | train", text)
    six = ("BC", "DAgger", "GAIL", "BCO", "SQIL", "IUPE")
    cells = [re.findall(r"\d+", rows[name])[1:7] for name in six]  # Ours, printed, by split.
    train, new, printed = ([int(row[i]) for row in cells] for i in (0, 4, 5))
    paragraph = " ".join(path.read_text(encoding="utf-8").split("\n\n")[2].split())
    assert f"solve {min(train)}% or more of the labyrinths they have seen" in paragraph
    assert f"{min(new)} to {max(new)}% of new ones" in paragraph
    assert f"The paper reports {min(printed)} to {max(printed)}% on this split" in paragraph
    if path.stem == "README":  # A card has these figures of its own dataset.
        memory, walk = rows["*route memory*"].split(" | ")[3], table("", text)["*random*"].split()
        assert f"training routes solves {memory}%" in paragraph
        assert f"path length) is {walk[-1]}%" in paragraph


def test_the_example_of_the_language_is_canonical():
    text = (ROOT / "docs" / "language.md").read_text(encoding="utf-8")
    example = "key_and_lock" + text.split('"""\nkey_and_lock', 1)[1].split("```", 1)[0]
    assert dump(parse(example)) == example


@pytest.mark.parametrize("document", CURRENT, ids=lambda path: path.name)
def test_no_code_escapes_a_bar_which_the_site_would_show_with_its_backslash(document):
    assert not re.findall(r"`[^`\n]*\\\|[^`\n]*`", document.read_text(encoding="utf-8"))


def test_the_check_runs_the_test_command_of_the_readme():
    command = re.search(r"^pip install -c .* && pytest$", README, re.MULTILINE)
    assert command is not None
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    lines = script.partition("apt-get install")[0].splitlines()
    install, test = command[0].split(" && ")
    assert lines.index(install) < lines.index(test)


@pytest.mark.slow
def test_the_last_lines_of_the_tests_name_the_programs_that_are_missing(tmp_path):
    needs = ["tests/labyrinth_core/pictures/test_png.py", "tests/test_run_documentation.py"]
    command = [sys.executable, "-m", "pytest", "-n1", "-p", "no:cacheprovider", *needs]
    command.append(f"--basetemp={tmp_path / 'own'}")  # Or it would delete folders of earlier runs.
    done = subprocess.run(
        [*command, "-m", "programs"],
        env=os.environ | {"PATH": str(tmp_path)},
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    *_, missing, install, count = done.stdout.splitlines()
    found = re.fullmatch(r"(\d+) tests skipped; programs not installed: bash pngcheck zsh", missing)
    assert found is not None, missing
    assert "apt-get install bash pngcheck zsh " in install
    assert re.match(f"{found[1]} skipped in ", count)


def test_the_list_of_defects_names_tests_that_exist():
    text = (ROOT / "tests" / "defects.md").read_text(encoding="utf-8")
    named = re.findall(r"^\| .+ \| `([\w/]+\.py)::(\w+)` \|$", text, re.MULTILINE)
    assert len(named) == text.count("\n| ") - 1 > 0  # But for the heading of the table.
    gone = [name for path, name in named if f"def {name}(" not in (ROOT / path).read_text("utf-8")]
    assert gone == []


def paths(text: str) -> Iterator[str]:
    """Yield the paths that a text names in back-ticks or runs, and that are of this repository."""
    for quoted in [*re.findall(r"`([^`\s]+)`", text), *re.findall(r"python (\S+\.py)", text)]:
        is_path = "/" in quoted and (quoted.endswith("/") or "." in Path(quoted).name)
        if is_path and quoted.split("/")[0] in OURS:
            yield quoted


def test_options_with_brackets_are_quoted_for_zsh():
    """In pages, and in all that the program prints but its hints, which it quotes as it prints."""
    programs = {*ROOT.glob("pipeline/**/*.*"), *ROOT.glob("labyrinth_core/**/*.py")}
    programs.discard(ROOT / "pipeline" / "machinery" / "hints.py")
    shown = [
        path for path in [*CURRENT, *programs] if path.suffix in (".py", ".js", ".md", ".yaml")
    ]
    unquoted = [
        f"{path.relative_to(ROOT)}: {match[0]}"
        for path in shown
        for match in re.finditer(
            r"(?<!['\w.])(stages|shifts|\w+\.splits)=\[\w+.*", path.read_text(encoding="utf-8")
        )
    ]
    assert unquoted == []


def anchors(document: Path) -> set[str]:
    """Return the anchors of a document's headings, as GitHub and the Hub make them."""
    headings = re.findall(r"^#+ (.*)$", document.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_link_to_a_file_leads_to_one(document):
    text = document.read_text(encoding="utf-8")
    for link, anchor in re.findall(r"\]\(([^)#:]*)(?:#([^)]*))?\)", text):
        target = document.parent / link if link else document
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), f"{link}#{anchor}"


def test_every_picture_of_the_documentation_is_shown():
    texts = "".join(path.read_text(encoding="utf-8") for path in CURRENT)
    pictures = [path.name for path in (ROOT / "docs" / "pictures").iterdir()]
    assert [name for name in pictures if f"pictures/{name})" not in texts] == []


@pytest.mark.parametrize("document", CURRENT, ids=lambda path: path.name)
def test_every_path_that_is_named_exists(document):
    for path in paths(document.read_text(encoding="utf-8")):
        assert any(ROOT.glob(path.rstrip("/"))), path


@pytest.mark.parametrize("document", CURRENT, ids=lambda path: path.name)
def test_every_dotted_name_of_the_library_is_one(document):
    text = document.read_text(encoding="utf-8")
    for name in re.findall(r"`(labyrinth_core\.[\w.]+)`", text):
        assert pkgutil.resolve_name(name) is not None


def test_a_name_without_a_folder_lies_in_that_of_the_name_before_it():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for row in text.split("| to change | open |\n", 1)[1].split("\n\n", 1)[0].splitlines():
        folder = ROOT
        for name in re.findall(r"`([\w./-]+(?:\.py|\.js|\.csv|\.md|\.yaml|/))`", row):
            path = ROOT / name if (ROOT / name).exists() else folder / name
            assert path.exists(), f"{name} in: {row}"
            folder = path if path.is_dir() else path.parent


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_python_block_is_python_and_a_readers_imports_nothing_of_the_program(document):
    for block in blocks(document):
        compile(block, document.name, "exec")
        if document in FOR_READERS:
            assert not re.search(r"^\s*(from|import) pipeline", block, re.MULTILINE)


def test_the_version_is_the_same_everywhere():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == __version__
    assert f"## {__version__}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
