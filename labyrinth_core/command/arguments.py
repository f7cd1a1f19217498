"""The parser of the command line, and the errors that its users can cause."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from labyrinth_core.errors import printable, printable_line
from labyrinth_core.language import LabyrinthSyntaxError, parse_size
from labyrinth_core.version import __version__
from labyrinth_core.world import LabyrinthError, Task

ROUTES = 1_000
"""The default limit of `solve --all`."""


class RequestError(ValueError):
    """A command that cannot be carried out; the message says why."""


ERRORS = (OSError, LabyrinthSyntaxError, LabyrinthError, RequestError)
"""The errors that a user can cause, which are shown without a traceback."""


def explain(error: Exception) -> None:
    """Print one of the `ERRORS` on standard error."""
    message = str(error)
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename is not None else ""
        message = where + (error.strerror or message)
    if isinstance(error, LabyrinthSyntaxError):
        print(printable(message), file=sys.stderr)  # It has several lines.
    else:
        print(printable_line(f"labyrinth: {message}"), file=sys.stderr)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(1, f"{self.prog}: {printable_line(message)} (see {self.prog} --help)\n")


def _size(text: str) -> tuple[int, int]:
    try:
        return parse_size(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _task(text: str) -> Task:
    try:
        return Task(text.replace("-", "_"))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: choose one of {', '.join(Task)}") from error


def _whole(least: int) -> Callable[[str], int]:
    def number(text: str) -> int:
        if not (text.isascii() and text.isdigit() and len(text) < 20 and int(text) >= least):
            raise argparse.ArgumentTypeError(f"{text!r}: give a whole number from {least:,} on")
        return int(text)

    return number


def _probability(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = -1
    if not 0 <= number <= 1:
        raise argparse.ArgumentTypeError(f"{text!r}: give a probability from 0 to 1")
    return number


def _file(suffix: str) -> Callable[[str], Path]:
    def path(text: str) -> Path:
        if not text.lower().endswith(suffix):
            raise argparse.ArgumentTypeError(f"{text!r}: give a name that ends in {suffix}")
        return Path(text)

    return path


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line, which exits with status 1 after an error."""
    parser = _Parser(
        prog="labyrinth",
        description="Check, show, solve, make and convert labyrinths in the text language.",
    )
    parser.add_argument("--version", action="version", version=f"labyrinth {__version__}")
    commands = parser.add_subparsers(
        title="commands", dest="command", required=True, metavar="COMMAND"
    )

    def command(name: str, text: str) -> argparse.ArgumentParser:
        summary = text[0].lower() + text[1:].split(".")[0]
        added: argparse.ArgumentParser = commands.add_parser(name, help=summary, description=text)
        return added

    text = (
        "Check that each file holds a labyrinth. Errors are shown with line and column, and make "
        "the exit status 1."
    )
    check = command("check", text)
    text = (
        "Print a labyrinth, in colour on a terminal, or make a picture of it. Without --solution "
        "the plain text is the canonical form of the file. A labyrinth without a route is drawn, "
        "too; the reason is shown, and the exit status is 1."
    )
    show = command("show", text)
    solve = command("solve", "Print a shortest route as the actions to take.")
    new = command("new", "Draw a random or blank labyrinth and print its text.")
    text = (
        "Print a labyrinth in another format as text. A file that ends in .npy holds wall grids or "
        "mazes of maze-dataset; a folder holds several files; any other file is a list of edges."
    )
    convert = command("convert", text)

    help_of_file = "a file; - for standard input"
    check.add_argument("files", nargs="+", metavar="FILE", help=help_of_file)
    for each in (show, solve, convert):
        each.add_argument("file", metavar="FILE", help=help_of_file)
    text = "determines where missing tiles of the task are placed (default: %(default)s)"
    for each in (check, show, solve):
        each.add_argument("--seed", type=_whole(0), default=0, metavar="N", help=text)

    show.add_argument(
        "--png", type=_file(".png"), metavar="OUT", help="write a picture to this file"
    )
    show.add_argument("--solution", action="store_true", help="mark a shortest route")

    text = "write an animation of a shortest route to this file"
    show.add_argument("--gif", type=_file(".gif"), metavar="OUT", help=text)

    solve.add_argument("--all", action="store_true", help="print every route without a loop")
    text = f"stop --all after N routes (default: {ROUTES:,})"
    solve.add_argument("--limit", type=_whole(1), metavar="N", help=text)

    text = "height x width such as 4x6, or one number for a square (default: 5)"
    new.add_argument("--size", type=_size, default=(5, 5), metavar="SIZE", help=text)
    text = f"one of {', '.join(Task)} (default: %(default)s)"
    new.add_argument("--task", type=_task, default=Task.NAVIGATION, metavar="TASK", help=text)
    text = "the same seed makes the same labyrinth (default: a random seed)"
    new.add_argument("--seed", type=_whole(0), metavar="N", help=text)
    new.add_argument(
        "--blank", action="store_true", help="no walls and no tiles: a drawing to edit by hand"
    )
    text = "how the spanning tree is drawn: wilson, depth_first, kruskal or prim"
    text = f"{text} (default: %(default)s)"
    new.add_argument("--sampler", default="wilson", metavar="NAME", help=text)
    text = "probability of opening each wall off the tree (default: about 0.1, by size)"
    new.add_argument("--open-walls", type=_probability, metavar="P", help=text)

    text = "height x width (default: the smallest square that has all the cells)"
    text = f"for a list of edges: {text}"
    convert.add_argument("--size", type=_size, metavar="SIZE", help=text)
    text = "write a .labyrinth file for each labyrinth into this new folder, by split"
    convert.add_argument("--output", type=Path, metavar="FOLDER", help=text)
    return parser
