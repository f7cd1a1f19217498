"""The check of the pages: what it lets pass, and what it finds."""

from __future__ import annotations

import pytest

from scripts import run_documentation

pytestmark = pytest.mark.slow

NOT_RUN = "<!-- not run: it takes hours -->\n"


IN_SHELLS = [
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
]
WITHOUT_A_SHELL = [
    ("```sh\ntrue  # A word for zsh.\n```", "a comment"),
    ("```python\nx = 1\n```\ntext\n```python\nassert x == 2\n```", "AssertionError"),
    (NOT_RUN + "```python\nx\n```", ""),
    ("<!-- written to of_a_page.py -->\n```python\n```\n```python\nimport of_a_page\n```", ""),
    (NOT_RUN + "```python\nx y\n```", "SyntaxError"),
]
"""Pages, and what is found in each; nothing where it does what it says."""


@pytest.mark.parametrize(
    ("page", "found"),
    [
        *(pytest.param(*each, marks=pytest.mark.programs("bash", "zsh")) for each in IN_SHELLS),
        *WITHOUT_A_SHELL,
    ],
)
def test_a_page_passes_if_it_does_what_it_says(page, found, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # Which the check leaves.
    path = tmp_path / "page.md"
    path.write_text(page + "\n")
    line, works = run_documentation.walk(path, "bash")
    assert works is (not found)
    assert found in line
