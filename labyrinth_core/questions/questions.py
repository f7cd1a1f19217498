"""Questions for vision and language models: a labyrinth as picture and text, and its routes.

A dataset's questions are a config beside it, such as `5x5-questions`, with one row for each
labyrinth of test and of each shift. The stage `questions` writes all; `question` makes one.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from typing import Any

from labyrinth_core.data import Columns
from labyrinth_core.language import draw_text, dump, labyrinth_id, parse
from labyrinth_core.pictures import COLOURS_IN_WORDS, PICTURE_SIZE, Painter
from labyrinth_core.world import TILES, Action, Labyrinth, Solver

SMALL_PICTURE = 300
MOST_ROUTES = 1_000
"""The most shortest routes that a question may have; 5x5 without walls has 70."""


QUESTION_COLUMNS = Columns.of(
    ("labyrinth_id", "string", "hash of the labyrinth, as in the table of labyrinths"),
    ("image", "Image", "picture of the first state, 600 x 600 RGB, PNG"),
    ("image_300", "Image", "the same at 300 x 300"),
    ("text", "string", "drawing of the first state, the agent as @"),
    ("prompt", "string", "question about the drawing, which is in it"),
    ("picture_prompt", "string", "question about the picture"),
    ("image_url", "string", "`image` as a data URL, for tools that take pictures as text"),
    (
        "routes",
        {"feature": {"dtype": "string", "_type": "Value"}, "_type": "List"},
        "all shortest routes, each as words such as up right",
    ),
    (
        "answer",
        "string",
        "first of `routes`: where two part, up comes before right, down, left",
    ),
    ("moves", "int32", "moves of a shortest route"),
    ("info", "string", "the labyrinth, in the text language that loads it again"),
)

_PROMPT = """{shown} Find a shortest route from the agent ({agent}) to the goal ({goal}). \
Each move leads up, right, down or left to the next cell, and never through a wall.{rule}

{drawing}End your answer with one line that has all moves of the route, in this form:
ANSWER: up right right down"""
_DRAWN = (
    "Here is a labyrinth of {size} as text. Cells and walls alternate: | and - are walls, a "
    "blank between two cells is an open passage, + is the point between four cells."
)
_PICTURED = "The picture shows a labyrinth of {size} from above, with lines as walls."
_SIGNS = {"agent": "@", "goal": "E"} | {tile.name: tile.letter for tile in TILES}


def question(labyrinth: Labyrinth | str) -> dict[str, Any]:
    """Return the question about a labyrinth, with the values of `QUESTION_COLUMNS` by name.

    `image` and `image_300` are dictionaries of `bytes`, a PNG file, and `path`, its name: the form
    of undecoded pictures in the library `datasets`. The agent begins on the start, whatever the
    labyrinth says.

    Args:
        labyrinth: The labyrinth, or its text, such as from the column `info`.

    Raises:
        ValueError: Most of the labyrinth is hidden from its agent (partial observability), it has
            more than `MOST_ROUTES` shortest routes, or the text does not describe a labyrinth.
    """
    if isinstance(labyrinth, str):
        labyrinth = parse(labyrinth)
    if labyrinth.task.rules.hides:
        raise ValueError(
            f"task={labyrinth.task}: most of the labyrinth is hidden from the agent, so "
            "no question can be asked; choose another task"
        )
    solver = Solver(labyrinth)
    moves, count = solver.moves_and_routes()
    info = dump(labyrinth)
    name = labyrinth_id(info)
    if count > MOST_ROUTES:
        raise ValueError(
            f"labyrinth {name} has {count:,} shortest routes, and a question lists them all, "
            f"{MOST_ROUTES:,} at most"
        )
    words = [action.name.lower() for action in Action]
    routes = [" ".join(words[move] for move in route) for route in solver.shortest_routes()]
    state, painter = labyrinth.initial, Painter(labyrinth)
    large, drawing = painter.png(state), draw_text(labyrinth, state)
    small = painter.png(state, SMALL_PICTURE)
    return {
        "labyrinth_id": name,
        "image": {"bytes": large, "path": f"{name}-{PICTURE_SIZE}.png"},
        "image_300": {"bytes": small, "path": f"{name}-{SMALL_PICTURE}.png"},
        "text": drawing,
        "prompt": _prompt(labyrinth, _DRAWN, _SIGNS, f"{drawing}\n"),
        "picture_prompt": _prompt(labyrinth, _PICTURED, COLOURS_IN_WORDS[labyrinth.look]),
        "image_url": f"data:image/png;base64,{b64encode(large).decode()}",
        "routes": routes,
        "answer": routes[0],
        "moves": moves,
        "info": info,
    }


def _prompt(labyrinth: Labyrinth, shown: str, names: Mapping[str, str], drawing: str = "") -> str:
    """Return the text of a question; `names` says how agent, goal and tiles are shown."""
    structure = labyrinth.structure
    size = f"{structure.height} rows and {structure.width} columns of cells"
    rule = labyrinth.task.rules.question.format(**names)
    return _PROMPT.format(shown=shown.format(size=size), rule=rule, drawing=drawing, **names)
