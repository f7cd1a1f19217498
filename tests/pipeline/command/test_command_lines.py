"""Command lines and what they answer: exit status and output, as `command_lines.txt` holds them.

Those of a wing are in a file of this name in the folder of its tests.

Of the configuration that `--cfg job` prints, the file has the lines that differ from the defaults.
`PYTHONPATH=.:tests python tests/pipeline/command/test_command_lines.py` writes the files again;
`git diff` then shows what changed for a user.
"""

from __future__ import annotations

import difflib
import re
import shlex
from contextlib import chdir
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from support.commands import RUN, answered, run

from labyrinth_core.data import SPLITS
from labyrinth_core.world import Task

pytestmark = pytest.mark.slow

KEPT = sorted(Path(__file__).parents[1].glob("*/command_lines.txt"))

FILES = {
    "own/mine.yaml": "defaults: [config, _self_]\nsize: 3\nrevision: '1.10'\n",
    "own/method/gentle.yaml": "_target_: mine.Method\nepochs: 3\nsmoothing: 0.5\n",
    "own/experiment/small.yaml": "# @package _global_\nsize: 3\nhydra: {sweeper: {params: "
    "{seed: '0,1'}}}\n",
    "broken/mine.yaml": "size: [5",
}
"""What the folder of each command line holds."""

LOGGING = {"-m", "--multi", "--info"}


def answer(line: str) -> tuple[int, str, str]:
    """Return the exit status of a command line, and what it printed, without the folder's name."""
    with TemporaryDirectory() as folder, chdir(folder), pytest.MonkeyPatch.context() as patch:
        for name, content in FILES.items():
            path = Path(folder, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content, encoding="utf-8")
        patch.setenv("COLUMNS", "80")
        arguments = shlex.split(line)
        # What a sweep and `--info` log, and what is said once, are of the whole process.
        as_process = not LOGGING.isdisjoint(arguments)
        done = run(Path(folder), *arguments) if as_process else answered(*arguments)
    changing = {
        re.escape(str(Path(folder).resolve())): "FOLDER",
        re.escape(str(RUN.parent)): "CLONE",
        r"\d{4}-\d\d-\d\d[/ ]\d\d[-:]\d\d[-:]\d\d(,\d+)?": "DATE",
        r"Hydra \(\S+\)": "Hydra",
        # So that a new task or shift changes no line.
        ", ".join(Task): "TASKS",
        ", ".join(SPLITS.shifts): "SHIFTS",
        r"usage: (.|\n)*\n(?=run.py: )": "",  # It differs between versions of Python.
    }
    printed, errors = done.stdout, done.stderr
    for pattern, name in changing.items():
        printed, errors = re.sub(pattern, name, printed), re.sub(pattern, name, errors)
    return done.returncode, printed, errors


@cache
def usual() -> list[str]:
    """Return the lines of the default configuration."""
    return answer("--cfg job")[1].splitlines()


def block(line: str) -> str:
    """Return the text of the file about a command line."""
    status, printed, errors = answer(line)
    lines = printed.splitlines()
    if "sampler: wilson" in lines:
        lines = [each for each in difflib.ndiff(usual(), lines) if each[0] in "+-"]
    elif len(lines) > 12:
        lines = [*lines[:6], f"... ({len(lines) - 6} more)"]
    shown = [*lines, *(f"! {each}" for each in errors.splitlines())]
    return "\n".join([f"$ {line}", f"= {status}", *shown]) + "\n"


def kept(*files: Path) -> dict[str, str]:
    """Return the blocks of files, all by default, by their command lines."""
    texts = [path.read_text(encoding="utf-8") for path in files or KEPT]
    blocks = [f"$ {each}" for text in texts for each in text.split("\n$ ")[1:]]
    return {each.splitlines()[0].removeprefix("$ "): each for each in blocks}


@pytest.mark.parametrize("line", kept())
def test_a_command_line_answers_what_is_written_down(line: str) -> None:
    assert block(line).rstrip() == kept()[line].rstrip()


def test_sixty_command_lines_are_written_down() -> None:
    assert len(kept()) > 60


if __name__ == "__main__":
    for path in KEPT:
        path.write_text("\n" + "\n".join(map(block, kept(path))), encoding="utf-8")
