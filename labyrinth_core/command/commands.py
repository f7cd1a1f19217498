"""The commands: check, show, solve, new and convert."""

from __future__ import annotations

import io
import os
import re
import sys
from argparse import Namespace
from pathlib import Path

import numpy as np

from labyrinth_core.command.arguments import ERRORS, ROUTES, RequestError, explain
from labyrinth_core.command.conversion import convert
from labyrinth_core.errors import printable_line
from labyrinth_core.language import (
    Collection,
    LabyrinthSyntaxError,
    draw_text,
    dump,
    parse,
    parse_edges,
    parse_sketch,
    read_text,
)
from labyrinth_core.pictures import MAX_PICTURED_SIDE, Painter, animate, render
from labyrinth_core.storage import File, LocalFile
from labyrinth_core.world import (
    ALGORITHMS,
    Action,
    Episode,
    Labyrinth,
    Sketch,
    Solver,
    Structure,
    sample_labyrinth,
)

COLOURS = {"S": "1;31", "E": "1;34", "K": "1;33", "D": "1;35", "I": "1;36", ".": "32"}
"""The colour of each character on a terminal, as parameters of the SGR sequence (ECMA-48)."""


def _read(file: str) -> tuple[str, str]:
    """Return the text of a file, or of standard input for `-`, and its name."""
    if file == "-":
        if sys.stdin is None:
            raise RequestError("standard input is closed")
        return read_text(sys.stdin.buffer, "<stdin>"), "<stdin>"
    return read_text(Path(file)), file


def _load(options: Namespace, file: str | None = None) -> Labyrinth:
    text, name = _read(file or options.file)
    return parse(text, file=name, seed=options.seed)


def _optimal(labyrinth: Labyrinth) -> Episode:
    return labyrinth.replay(Solver(labyrinth).shortest_route(np.random.default_rng(0)))


def _counted(number: int, noun: str) -> str:
    return f"{number:,} {noun}" + ("" if number == 1 else "s")


def _check(options: Namespace) -> int:
    status = 0
    for file in options.files:
        try:
            labyrinth = _load(options, file)
        except BrokenPipeError:
            raise
        except ERRORS as error:
            explain(error)
            status = 1
            continue
        moves = _counted(len(_optimal(labyrinth)), "move")
        print(f"{printable_line(file)}: ok, {labyrinth.size_name}, {labyrinth.task}, {moves}")
    return status


def _show(options: Namespace) -> int:
    text, name = _read(options.file)
    status = 0
    try:
        labyrinth = parse(text, file=name, seed=options.seed)
    except LabyrinthSyntaxError as error:
        if options.solution or options.gif is not None:
            raise
        labyrinth = parse_sketch(text, file=name)  # Raises if there is nothing to draw.
        explain(error)
        status = 1
    cells = [state.agent for state in _optimal(labyrinth).states] if options.solution else []
    if options.png is not None:
        File(LocalFile(options.png).target()).write_bytes(_picture(labyrinth, cells))
    if options.gif is not None:
        File(LocalFile(options.gif).target()).write_bytes(_moving_picture(labyrinth))
    if options.png is options.gif is None:
        drawing = draw_text(labyrinth, route=cells)
        if sys.stdout.isatty() and not os.environ.get("NO_COLOR"):  # See https://no-color.org.
            tiles = "|".join(f"{re.escape(tile)}+" for tile in COLOURS)
            drawing = re.sub(
                tiles, lambda run: f"\x1b[{COLOURS[run[0][0]]}m{run[0]}\x1b[0m", drawing
            )
        settings, _, _ = dump(labyrinth).partition("-")
        sys.stdout.write(f"{settings}{drawing}end\n")
    return status


def _pictured_side(labyrinth: Labyrinth) -> int:
    """Return the longer side of a labyrinth in cells; raise RequestError if no picture fits it."""
    most = max(labyrinth.structure.height, labyrinth.structure.width)
    if most > MAX_PICTURED_SIDE:
        raise RequestError(
            f"a picture has room for {MAX_PICTURED_SIDE} rows and columns, not {most}"
        )
    return most


def _picture(labyrinth: Labyrinth, route: list[int]) -> bytes:
    """Return a PNG file of a labyrinth in its initial state, with a route drawn on it."""
    height, width = labyrinth.structure.height, labyrinth.structure.width
    most = _pictured_side(labyrinth)
    if not route:
        return Painter(labyrinth).png(labyrinth.initial)
    try:
        from PIL import Image, ImageDraw
    except ImportError as error:
        raise RequestError("drawing the solution needs Pillow: pip install pillow") from error
    image = Image.fromarray(render(labyrinth, labyrinth.initial))
    pencil = ImageDraw.Draw(image)
    # The grid is centred in the picture, and its lines are a twelfth of a cell thick.
    side = image.width / (most + 1 / 12)
    left, bottom = (image.width - width * side) / 2, (image.height + height * side) / 2
    points = [
        (left + (column + 0.5) * side, bottom - (row + 0.5) * side)
        for row, column in map(labyrinth.position, route)
    ]
    colour = (204, 121, 167)
    pencil.line(points, fill=colour, width=max(1, round(side / 15)))
    for x, y in points:
        radius = side / 12
        pencil.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)
    file = io.BytesIO()
    image.save(file, "PNG")
    return file.getvalue()


def _moving_picture(labyrinth: Labyrinth) -> bytes:
    """Return a GIF file that shows a shortest route."""
    _pictured_side(labyrinth)
    try:
        return animate(_optimal(labyrinth))
    except ImportError as error:
        raise RequestError("a GIF file needs Pillow: pip install pillow") from error


def _solve(options: Namespace) -> int:
    if options.limit is not None and not options.all:
        raise RequestError("--limit needs --all")
    labyrinth = _load(options)
    routes = [_optimal(labyrinth).actions.tolist()]
    if options.all:
        limit = options.limit or ROUTES
        routes = Solver(labyrinth).simple_routes(limit)
        if len(routes) == limit < len(Solver(labyrinth).simple_routes(limit + 1)):
            print(f"labyrinth: stopped after {_counted(limit, 'route')} (--limit)", file=sys.stderr)
    for actions in routes:
        words = " ".join(Action(action).name.lower() for action in actions)
        print(f"{_counted(len(actions), 'move')}: {words}")
    return 0


def _new(options: Namespace) -> int:
    if options.sampler not in ALGORITHMS:
        raise RequestError(f"sampler={options.sampler}: choose one of {', '.join(ALGORITHMS)}")
    height, width = options.size
    if options.blank:
        if options.sampler != "wilson" or (options.open_walls, options.seed) != (None, None):
            raise RequestError("--blank needs no --sampler, --open-walls or --seed")
        structure = Structure.without_walls(height, width)
        sys.stdout.write(dump(Sketch(structure, *structure.default_ends, options.task)))
        return 0
    labyrinth = sample_labyrinth(
        height,
        width,
        options.task,
        np.random.default_rng(options.seed),
        algorithm=options.sampler,
        open_walls=options.open_walls,
    )
    sys.stdout.write(dump(labyrinth))
    return 0


def _convert(options: Namespace) -> int:
    if options.file != "-":
        Path(options.file).stat()  # Raises if it does not exist, whatever the other options are.
    if options.file != "-" and Collection.is_at(Path(options.file)):
        if options.size is not None:
            raise RequestError("--size is only for lists of edges")
        return convert(Path(options.file), options.output)
    if options.output is not None:
        raise RequestError(
            f"--output is only for folders and files that end in {', '.join(Collection.SUFFIXES)}"
        )
    height, width = options.size or (None, None)
    text, name = _read(options.file)
    sys.stdout.write(dump(parse_edges(text, height=height, width=width, file=name)))
    return 0


COMMANDS = {
    "check": _check,
    "show": _show,
    "solve": _solve,
    "new": _new,
    "convert": _convert,
}
