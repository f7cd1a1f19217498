"""Do what the pages say, block by block, each page in a folder of its own, for bash and for zsh.

    python scripts/run_documentation.py            # README.md and all guides
    python scripts/run_documentation.py README.md docs/make.md

A folder holds at first what a clone has. Commands run in one of the shells, the pages taking turns,
and the other shell has to make the same words of each line, so that it would do the same. Programs
in Python share one interpreter a page. `pip install` is left out. A block fails if it ends with a
status other than 0, or has a comment, which zsh takes for words where it is typed.

A comment in the line before a block says what differs:

    <!-- not run: it needs the Hub -->              its words are compared and its options checked
    <!-- run with: labyrinths=20 seed=0 -->         these options follow those of `run.py`
    <!-- run beside mine.py: policy = len -->       a file of this one line is there
    <!-- written to mine.py -->                     the block is this file, and is not run
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
from concurrent.futures import ProcessPoolExecutor
from itertools import cycle
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser

from pipeline.config.command_line import HYDRA, keep_texts, register
from pipeline.config.run import options_of, resolve
from pipeline.config.training import CONF

ROOT = Path(__file__).parents[1]
CLONE = ("run.py", "scripts", "examples", "constraints.txt")
"""What pages name of a clone."""
SHELLS = {
    "bash": (["bash", "--norc", "-ec"], "command_not_found_handle"),
    "zsh": (["zsh", "-f", "-ec"], "command_not_found_handler"),
}
"""How a shell is started, and its function for a command that does not exist."""
BLOCK = re.compile(r"(?:<!-- (?P<mark>[^>]*) -->\n)?```(?P<kind>sh|python)\n(?P<text>.*?)```", re.S)
SECONDS = 300
"""How long a block may take."""


class BlockError(Exception):
    """A block of a page does not do what it says."""


def guides() -> list[Path]:
    """Return the README and the pages of the site that lie at the top of docs/, in its order."""
    pages = re.findall(r": ([\w-]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)
    return [ROOT / "README.md", *(ROOT / "docs" / each for each in pages if each != "changelog.md")]


def shell(name: str, text: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """Return what came of a text in a shell.

    Raises:
        BlockError: The status is not 0; the text has the last lines of the output.
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
    """Return the words that a shell makes of each command of a text, of which none is run."""
    _, handler = SHELLS[name]
    show = f"PATH=/nowhere\n{handler}() {{ printf '%s\\0' \"$@\" $'\\n' >&2; }}\n"
    with tempfile.TemporaryDirectory() as folder:
        seen = shell(name, show + text, cwd=folder).stderr
    return [line.strip("\0\n").split("\0") for line in seen.split("\n\0") if line.strip("\0\n")]


def check_options(command: list[str]) -> None:
    """Raise an error if the options of a command of ours, the first run of a sweep, are refused."""
    if command[:2] == ["python", "run.py"]:
        given = OverridesParser.create().parse_overrides(
            [keep_texts(word) for word in command[2:] if word != "-m"]
        )
        values = [
            f"{each.get_key_element()}={next(each.sweep_string_iterator())}"
            if each.is_sweep_override()
            else str(each.input_line)
            for each in given
            if not each.is_hydra_override()
        ]
        with initialize_config_dir(str(CONF.absolute()), **HYDRA):
            resolve(options_of(compose("config", values)))


def run_commands(text: str, mark: str, first: str) -> None:
    """Do what the commands of a block do, in the current folder."""
    if "#" in text:
        raise BlockError("a comment, which zsh takes for words where it is typed")
    by_shell = {name: words(name, text.replace("scripts/", "")) for name in SHELLS}
    if by_shell["bash"] != by_shell["zsh"]:
        raise BlockError(f"the shells make other words of it: {by_shell}")
    if mark.startswith("not run: "):
        for command in by_shell[first]:
            check_options(command)
        return
    text = re.sub(r"pip install[^\n&]*", "true ", text.replace("\\\n", " "))
    if mark.startswith("run with: "):
        text = re.sub(r"(python run\.py .*)", rf"\1 {mark.removeprefix('run with: ')}", text)
    shell(first, text)


def run_program(text: str, mark: str, names: dict[str, Any]) -> None:
    """Run a program in Python, unless it is only to be compiled."""
    program = compile(text, "page", "exec")
    if not mark.startswith("not run: "):
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            exec(program, names)


def walk(page: Path, first: str) -> tuple[str, bool]:
    """Do what a page says, and return a line about it, and whether all of it works."""
    started = time.monotonic()
    names: dict[str, Any] = {"__name__": "__main__"}
    blocks = list(BLOCK.finditer(page.read_text(encoding="utf-8")))
    register()
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


def main() -> int:
    """Return the exit status: 1 where a page does not work, which is shown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path, help="README.md and all guides by default")
    pages = [page.absolute() for page in parser.parse_args().pages] or guides()
    with tempfile.TemporaryDirectory() as cache:
        # Programs that a page starts are those of this environment.
        os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        os.environ |= {"XDG_CACHE_HOME": cache, "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
        with ProcessPoolExecutor(2, get_context("spawn")) as pool:
            works = True
            for line, each in pool.map(walk, pages, cycle(SHELLS)):
                print(line, flush=True)
                works &= each
    return 0 if works else 1


if __name__ == "__main__":
    sys.exit(main())
