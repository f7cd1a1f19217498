"""The check of the pages: what it lets pass, and what it finds."""

from __future__ import annotations

import pytest

from scripts import run_documentation

pytestmark = pytest.mark.slow

NOT_RUN = "<!-- not run: it takes hours -->\n"


@pytest.mark.programs("bash", "zsh")
@pytest.mark.parametrize(
    ("page", "found"),
    [
        ("```sh\nls run.py\n```", ""),
        ("```sh\nls elsewhere\n```", "bash ends with status 2"),
        (NOT_RUN + "```sh\nls elsewhere\n```", ""),
        ("```sh\nprintf x=[ab]\n```", "no matches found: x=[ab]"),
        ("```sh\necho {1..3} $[1 + 1] =ls\n```", "ls not found"),
        (NOT_RUN + "```sh\npython run.py size=0\n```", "size=0"),
        (NOT_RUN + "```sh\npython run.py -m size=3,0 'stages=[build,validate]'\n```", ""),
        ("<!-- run with: X=3 -->\n```sh\necho python run.py X=2 >out\ngrep X=3 out\n```", ""),
        ("<!-- run beside mine.txt: ours -->\n```sh\ngrep ours mine.txt\n```", ""),
        ("<!-- written to x.py -->\n```python\nx y\n```\n```sh\ngrep x x.py\n```", ""),
    ],
)
def test_a_page_passes_if_it_does_what_it_says(page, found, tmp_path, monkeypatch):
    check(page, found, tmp_path, monkeypatch)


@pytest.mark.parametrize(
    ("page", "found"),
    [
        ("```sh\ntrue  # A word for zsh.\n```", "a comment"),
        ("```python\nx = 1\n```\ntext\n```python\nassert x == 2\n```", "AssertionError"),
        (NOT_RUN + "```python\nx\n```", ""),
        (NOT_RUN + "```python\nx y\n```", "SyntaxError"),
    ],
)
def test_a_program_in_a_page_is_run_or_compiled_without_a_shell(page, found, tmp_path, monkeypatch):
    check(page, found, tmp_path, monkeypatch)


def check(page, found, tmp_path, monkeypatch):
    """Check that a page works, or fails with what is to be found in the line about it."""
    monkeypatch.chdir(tmp_path)  # Which the check leaves.
    path = tmp_path / "page.md"
    path.write_text(page + "\n")
    line, works = run_documentation.walk(path, "bash")
    assert works is (not found)
    assert found in line
