"""Nothing grows unnoticed: no room, page or module is much larger than tests/budgets.toml says.

A row falls with the commit that makes its room smaller. A row that rises by more than `SLACK` needs
a sentence in that commit's message. `python tests/test_budgets.py > tests/budgets.toml` writes
today's figures.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BUDGETS = ROOT / "tests/budgets.toml"

SLACK = 2
"""The percentage by which a figure may exceed its row: a line or a word more fails nothing."""

LONGEST, PAGE, WORDS = "longest module", "page of the report", "words of pages"
"""The rows that are not of a room."""


def figures(root: Path) -> dict[str, int]:
    """Return the lines of Python in each room, and the other figures, by the name of the row."""
    lines: dict[str, int] = {}
    longest = 0
    for package in ("labyrinth_core", "pipeline"):
        for path in root.glob(f"{package}/**/*.py"):
            inner = path.relative_to(root).parts
            room = "/".join(inner[:2]) if len(inner) > 2 else f"{package}/*.py"
            lines[room] = lines.get(room, 0) + lines_of(path)
            longest = max(longest, lines_of(path))
    for room in ("scripts", "tests"):
        lines[room] = sum(map(lines_of, root.glob(f"{room}/**/*.py")))
    page = [path for kind in ("js", "css", "html") for path in root.glob(f"pipeline/**/*.{kind}")]
    others = {
        PAGE: sum(map(lines_of, page)),
        WORDS: sum(map(words_of, pages(root))),
        LONGEST: longest,
    }
    return dict(sorted(lines.items())) | others


def lines_of(path: Path) -> int:
    """Return the number of lines of a file."""
    return len(path.read_bytes().splitlines())


def pages(root: Path) -> Iterator[Path]:
    """Yield the pages that readers read; those of results are tables that a script writes."""
    yield from (root / "README.md", root / "CONTRIBUTING.md")
    results = root / "docs/results"
    yield from (path for path in root.glob("docs/**/*.md") if results not in path.parents)


def words_of(path: Path) -> int:
    """Return the number of words of a page outside the tables that a script writes."""
    words, inside = 0, False
    for line in path.read_text(encoding="utf-8").splitlines():
        if inside:
            inside = "<!-- end of table" not in line
        elif "<!-- table:" in line:
            inside = True
        else:
            words += len(line.split())
    return words


def read(file: Path) -> dict[str, int]:
    """Return the budgets in a file, by the name of the row."""
    return tomllib.loads(file.read_text(encoding="utf-8"))


def most(budget: int) -> int:
    """Return the largest figure that a row allows, at least one more than its budget."""
    return budget + max(1, budget * SLACK // 100)


def advice(row: str, figure: int, budget: int) -> str:
    """Say by how much a figure exceeds its row, and what to do."""
    return (
        f"{row} has {figure:,}, more than its {budget:,} and {SLACK}%: remove {figure - budget:,} "
        f"there, or write {figure} into its row of tests/{BUDGETS.name} and say why in the message "
        "of the commit"
    )


FIGURES = figures(ROOT)


@pytest.mark.parametrize("row", FIGURES)
def test_nothing_is_larger_than_its_budget(row: str) -> None:
    budget = read(BUDGETS).get(row)
    assert budget is not None, f"{row} has no row in {BUDGETS.name}"
    assert FIGURES[row] <= most(budget), advice(row, FIGURES[row], budget)


def test_a_little_more_than_a_budget_fails_nothing_and_the_advice_names_the_row() -> None:
    assert [most(budget) for budget in (0, 10, 99, 100, 5_000)] == [1, 11, 100, 102, 5_100]
    told = advice("scripts", 5_101, 5_000)
    assert told.startswith("scripts has 5,101, more than its 5,000 and 2%: remove 101 there, or ")
    assert "write 5101 into its row of tests/budgets.toml" in told


def test_every_budget_is_that_of_something_or_of_a_wing_that_was_removed() -> None:
    from scripts.remove_wing import LIBRARY_OF_WINGS, WINGS

    wings = {f"pipeline/{wing}" for wing in WINGS}
    wings |= {f"labyrinth_core/{room}" for room in LIBRARY_OF_WINGS.values()}
    assert set(read(BUDGETS)) - set(FIGURES) <= wings


def test_a_line_and_a_word_more_are_counted_in_the_row_of_their_room(tmp_path: Path) -> None:
    for name, text in {
        "labyrinth_core/world/labyrinth.py": "one = 1\n",
        "labyrinth_core/version.py": "one = 1\n",
        "pipeline/report/page/page.js": "one\ntwo\n",
        "pipeline/report/deep/inside.py": "one = 1\ntwo = 2\n",
        "scripts/studies/any.py": "one = 1\n",
        "tests/any.py": "one = 1\n",
        "README.md": "three words here\n",
        "CONTRIBUTING.md": "one\n<!-- table: x -->\nnot counted\n<!-- end of table -->\n",
        "docs/studies/page.md": "one more\n",
        "docs/results/README.md": "not counted\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    before = {
        "labyrinth_core/*.py": 1,
        "labyrinth_core/world": 1,
        "pipeline/report": 2,
        "scripts": 1,
        "tests": 1,
        PAGE: 2,
        WORDS: 6,
        LONGEST: 2,
    }
    assert figures(tmp_path) == before
    with (tmp_path / "labyrinth_core/world/labyrinth.py").open("a") as file:
        file.write("two = 2\nthree = 3\n")
    assert figures(tmp_path) == before | {"labyrinth_core/world": 3, LONGEST: 3}


if __name__ == "__main__":
    for name, figure in FIGURES.items():
        print(f'"{name}" = {figure}')
