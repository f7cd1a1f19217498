"""Run the code blocks of the documentation, each page in its own folder, in bash or zsh.

    python scripts/run_documentation.py            # README.md and all guides
    python scripts/run_documentation.py README.md docs/make.md

A folder starts with the files of a clone that pages use. Pages alternate between the shells: a
page's commands run in one shell, and the other shell has to split each line into the same words, so
that it would do the same. The Python blocks of a page share one interpreter. `pip install` is
skipped. A block fails if its exit status is not 0, or if it has a comment, which zsh reads as words
at the prompt.

A comment in the line before a block changes how it is run:

    <!-- not run: it needs the Hub -->              its words are compared and its options checked
    <!-- run with: labyrinths=20 seed=0 -->         these options are appended to those of `run.py`
    <!-- run beside mine.py: policy = len -->       a file with this one line is written before
    <!-- written to mine.py -->                     the block is written to this file, and not run
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from itertools import cycle
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import IntervalSweep, Override

from pipeline.command.command_line import HYDRA, as_given, parsed, quote_texts, register
from pipeline.command.composed import CONF, options_of, resolve

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tests"))

from support.quick_python import python  # noqa: E402

CLONE = ("run.py", "scripts", "examples", "constraints.txt")
"""The files of a clone that pages use."""
SHELLS = {
    "bash": (["bash", "--norc", "-ec"], "command_not_found_handle"),
    "zsh": (["zsh", "-f", "-ec"], "command_not_found_handler"),
}
"""Shell -> how it is started, and its function for a command that does not exist."""
BLOCK = re.compile(r"(?:<!-- (?P<mark>[^>]*) -->\n)?```(?P<kind>sh|python)\n(?P<text>.*?)```", re.S)
SECONDS = 300
"""The time limit of a block."""


class BlockError(Exception):
    """A block of a page fails."""


def guides() -> list[Path]:
    """Return the README and the site's pages at the top of docs/, in the order of the site."""
    pages = re.findall(r": ([\w-]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)
    return [ROOT / "README.md", *(ROOT / "docs" / each for each in pages if each != "changelog.md")]


def shell(name: str, text: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a text in a shell, and return the completed process.

    Raises:
        BlockError: The exit status is not 0; the message has the last lines of the output.
    """
    start, _ = SHELLS[name]
    done = subprocess.run(
        [*start, text], capture_output=True, text=True, timeout=SECONDS, check=False, **options
    )
    if done.returncode:
        shown = "\n".join(f"{done.stdout}{done.stderr}".splitlines()[-20:])
        raise BlockError(f"{name} ends with status {done.returncode}:\n{shown}")
    return done


def words(name: str, text: str) -> list[list[str]]:
    """Return the words into which a shell splits each command of a text, without running any."""
    _, handler = SHELLS[name]
    show = f"PATH=/nowhere\n{handler}() {{ printf '%s\\0' \"$@\" $'\\n' >&2; }}\n"
    with tempfile.TemporaryDirectory() as folder:
        seen = shell(name, show + text, cwd=folder).stderr
    return [line.strip("\0\n").split("\0") for line in seen.split("\n\0") if line.strip("\0\n")]


def first_value(override: Override) -> object:
    """Return the first value of a sweep, of an interval its beginning."""
    swept = override.value()
    if isinstance(swept, IntervalSweep):
        return swept.start
    return next(override.sweep_string_iterator())


def check_options(command: list[str]) -> None:
    """Raise an error if `run.py` refuses a command's options; of a sweep, check the first run."""
    if command[:2] == ["python", "run.py"]:
        typed = map(quote_texts, parsed(command[2:]).overrides)
        given = OverridesParser.create().parse_overrides([*typed])
        values = [
            f"{each.get_key_element()}={first_value(each)}"
            if each.is_sweep_override()
            else str(each.input_line)
            for each in given
            if not each.is_hydra_override()
        ]
        with initialize_config_dir(str(CONF), **HYDRA):
            resolve(options_of(as_given(compose("config", values), values), values))


def run_commands(text: str, mark: str, first: str) -> None:
    """Run the commands of a block in the current folder, and compare how the shells read them."""
    if "#" in text:
        raise BlockError("the block has a comment, which zsh reads as words at the prompt")
    by_shell = {name: words(name, text.replace("scripts/", "")) for name in SHELLS}
    if by_shell["bash"] != by_shell["zsh"]:
        raise BlockError(f"the shells split it into different words: {by_shell}")
    if mark.startswith("not run: "):
        for command in by_shell[first]:
            check_options(command)
        return
    text = re.sub(r"pip install[^\n&]*", "true ", text.replace("\\\n", " "))
    if mark.startswith("run with: "):
        text = re.sub(r"(python run\.py .*)", rf"\1 {mark.removeprefix('run with: ')}", text)
    shell(first, text)


def run_program(text: str, mark: str, names: dict[str, Any]) -> None:
    """Run a Python block; with `not run`, only compile it."""
    program = compile(text, "page", "exec")
    if not mark.startswith("not run: "):
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            exec(program, names)


def walk(page: Path, first: str) -> tuple[str, bool]:
    """Run the blocks of a page; return a line to print, and whether all blocks work."""
    started = time.monotonic()
    names: dict[str, Any] = {"__name__": "__main__"}
    blocks = list(BLOCK.finditer(page.read_text(encoding="utf-8")))
    register()
    if "" not in sys.path:
        sys.path.insert(0, "")  # Python blocks import files that the page wrote, as at a prompt.
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for name in CLONE:
            Path(name).symlink_to(ROOT / name)
        for block in blocks:
            mark = block["mark"] or ""
            if beside := re.fullmatch(r"run beside (\S+): (.*)", mark):
                Path(beside[1]).write_text(beside[2] + "\n")
            try:
                if file := re.fullmatch(r"written to (\S+)", mark):
                    Path(file[1]).write_text(block["text"])
                elif block["kind"] == "sh":
                    run_commands(block["text"], mark, first)
                else:
                    run_program(block["text"], mark, names)
            except Exception as error:
                reason = error if isinstance(error, BlockError) else traceback.format_exc(limit=-3)
                return f"{page.name}: FAILED:\n{block['text']}\n{reason}", False
    seconds = time.monotonic() - started
    return f"{page.name}: {len(blocks)} blocks, {first}, {seconds:.0f} s", True


def run_all(work: Callable[..., tuple[str, bool]], *items: Iterable[Any]) -> int:
    """Call a function for each item in two processes, and print the lines that it returns.

    Programs are those of this environment, and a quick Python.

    Returns:
        The exit status, which is 1 if a call returns False.
    """
    programs = Path(python()).parent, Path(sys.executable).parent
    os.environ["PATH"] = os.pathsep.join([*map(str, programs), os.environ["PATH"]])
    works = True
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        for line, each in pool.map(work, *items):
            print(line, flush=True)
            works &= each
    return 0 if works else 1


def main() -> int:
    """Run the pages; return the exit status, which is 1 if one of them fails."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path, help="README.md and all guides by default")
    pages = [page.absolute() for page in parser.parse_args().pages] or guides()
    with tempfile.TemporaryDirectory() as cache:
        os.environ |= {"XDG_CACHE_HOME": cache, "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
        return run_all(walk, pages, cycle(SHELLS))


if __name__ == "__main__":
    sys.exit(main())
