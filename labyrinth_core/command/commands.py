"""What each command does: check, show, solve, new, convert and play."""

from __future__ import annotations

import io
import os
import sys
from argparse import Namespace
from pathlib import Path

import numpy as np

from labyrinth_core.command.arguments import ERRORS, GIF_ROUTES, ROUTES, RequestError, explain
from labyrinth_core.command.conversion import convert
from labyrinth_core.command.terminal_play import draw, play
from labyrinth_core.data.storage import write_bytes
from labyrinth_core.language.collection import KINDS, is_collection
from labyrinth_core.language.edge_list import parse_edges
from labyrinth_core.language.source_text import MAX_TEXT, decode, printable, read_text
from labyrinth_core.language.text import dump, parse
from labyrinth_core.pictures.animation import frames_of, gif
from labyrinth_core.pictures.renderer import MAX_PICTURED_SIDE, Painter, render
from labyrinth_core.world.dynamics import initial
from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.random_labyrinth import sample_labyrinth
from labyrinth_core.world.rollout import Episode, replay
from labyrinth_core.world.sampling import ALGORITHMS
from labyrinth_core.world.solver import shortest_route, simple_routes


def _read(file: str) -> tuple[str, str]:
    """Return the text of a file, or of standard input for `-`, and its name."""
    if file == "-":
        if sys.stdin is None:
            raise RequestError("standard input is closed")
        return decode(sys.stdin.buffer.read(MAX_TEXT + 1), "<stdin>"), "<stdin>"
    return read_text(Path(file)), file


def _load(options: Namespace, file: str | None = None) -> Labyrinth:
    text, name = _read(file or options.file)
    return parse(text, file=name, seed=options.seed)


def _optimal(labyrinth: Labyrinth) -> Episode:
    return replay(labyrinth, shortest_route(labyrinth, np.random.default_rng(0)))


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
        print(f"{printable(file)}: ok, {labyrinth.size_name}, {labyrinth.task}, {moves}")
    return status


def _show(options: Namespace) -> int:
    labyrinth = _load(options)
    cells = [state.agent for state in _optimal(labyrinth).states] if options.solution else []
    if options.png is not None:
        write_bytes(options.png, _picture(labyrinth, cells))
        return 0
    sys.stdout.write(draw(labyrinth, route=cells, colour=_in_colour()))
    return 0


def _in_colour() -> bool:
    """Return whether to print colours; see https://no-color.org."""
    return sys.stdout.isatty() and not os.environ.get("NO_COLOR")


def _pictured_side(labyrinth: Labyrinth) -> int:
    """Return the longer side of a labyrinth in cells, which has to have room in a picture."""
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
        return Painter(labyrinth).png(initial(labyrinth))
    try:
        from PIL import Image, ImageDraw
    except ImportError as error:
        raise RequestError("drawing the solution needs Pillow: pip install pillow") from error
    image = Image.fromarray(render(labyrinth, initial(labyrinth)))
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


def _check_limit(options: Namespace) -> None:
    if options.limit is not None and not options.all:
        raise RequestError("--limit goes with --all")


def _routes(labyrinth: Labyrinth, options: Namespace, most: int) -> list[list[int]]:
    """Return a shortest route, or with `--all` every route up to a limit, `most` by default."""
    if not options.all:
        return [_optimal(labyrinth).actions.tolist()]
    limit = options.limit or most
    routes = simple_routes(labyrinth, limit)
    if len(routes) == limit:
        print(f"labyrinth: stopped after {_counted(limit, 'route')} (--limit)", file=sys.stderr)
    return routes


def _solve(options: Namespace) -> int:
    _check_limit(options)
    for actions in _routes(_load(options), options, ROUTES):
        words = " ".join(Action(action).name.lower() for action in actions)
        print(f"{_counted(len(actions), 'move')}: {words}")
    return 0


def _new(options: Namespace) -> int:
    if options.sampler not in ALGORITHMS:
        raise RequestError(f"sampler={options.sampler}: choose one of {', '.join(ALGORITHMS)}")
    height, width = options.size
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
    if options.file != "-" and is_collection(Path(options.file)):
        if options.size is not None:
            raise RequestError("--size goes with a list of edges")
        return convert(Path(options.file), options.output)
    if options.output is not None:
        raise RequestError(f"--output goes with folders, and files that end in {', '.join(KINDS)}")
    height, width = options.size or (None, None)
    text, name = _read(options.file)
    sys.stdout.write(dump(parse_edges(text, height=height, width=width, file=name)))
    return 0


def _play(options: Namespace) -> int:
    _check_limit(options)
    if options.gif is not None:
        return _animate(options)
    if options.all:
        raise RequestError("--all goes with --gif")
    if options.file == "-" or sys.stdin is None or not sys.stdin.isatty():
        raise RequestError("play reads keys: give it a file, and a terminal as standard input")
    try:
        play(_load(options), colour=_in_colour())
    except ImportError as error:
        raise RequestError("play needs a terminal of the Unix kind (termios)") from error
    return 0


def _animate(options: Namespace) -> int:
    """Write the moving picture that `play --gif` asks for."""
    labyrinth = _load(options)
    _pictured_side(labyrinth)
    try:
        routes = _routes(labyrinth, options, GIF_ROUTES)
        picture = gif(frames_of(replay(labyrinth, actions)) for actions in routes)
    except ImportError as error:
        raise RequestError("a moving picture needs Pillow: pip install pillow") from error
    write_bytes(options.gif, picture)
    print(f"wrote {printable(str(options.gif))}")
    return 0


COMMANDS = {
    "check": _check,
    "show": _show,
    "solve": _solve,
    "new": _new,
    "convert": _convert,
    "play": _play,
}
