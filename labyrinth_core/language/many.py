"""Parse and write thousands of canonical texts, of labyrinths of one kind, at once in NumPy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.language.source_text import LabyrinthSyntaxError
from labyrinth_core.language.text import dump, parse
from labyrinth_core.world import Labyrinth, Labyrinths, Structure, Structures, Task


def parse_many(texts: Sequence[str]) -> Labyrinths | None:
    """Return the labyrinths of one or more texts, the same as `text.parse` returns.

    Returns:
        None if a text is invalid or not in the canonical form, or if the labyrinths differ in
        size, task or look; parse the texts one by one then.
    """
    heads, drawings = zip(*(text.partition("\n\n")[::2] for text in texts), strict=True)
    # Parse one text for each combination of settings.
    parsed = [_canonical(text) for text in dict(zip(heads, texts, strict=True)).values()]
    some = [each for each in parsed if each is not None]
    kinds = {(each.size_name, each.task, each.look) for each in some}
    if len(some) < len(parsed) or len(kinds) > 1:
        return None
    height, width = some[0].structure.height, some[0].structure.width
    pattern = dump(Labyrinth(Structure.without_walls(height, width), 0, height * width - 1))
    pattern = pattern.partition("\n\n")[2]
    joined = "".join(drawings)
    if {len(drawing) for drawing in drawings} != {len(pattern)} or not joined.isascii():
        return None
    shown = np.frombuffer(joined.encode(), np.uint8).reshape(len(texts), -1)
    cells, above, beside = _indices(pattern, height, width)
    fixed = np.ones(len(pattern), np.bool_)
    for free in (cells, above, beside):
        fixed[free] = False
    content, over, right_of = shown[:, cells.ravel()], shown[:, above], shown[:, beside]
    as_drawn = [
        shown[:, fixed] == np.frombuffer(pattern.encode(), np.uint8)[fixed],
        (over == ord(" ")) | (over == ord("-")),
        (right_of == ord(" ")) | (right_of == ord("|")),
    ]
    task = some[0].task
    own = task.rules.tiles
    singles = "SE" + "".join(tile.letter for tile in own if not tile.many)
    letters = np.frombuffer(singles.encode(), np.uint8)
    is_tile = content[:, None] == letters[:, None]
    ground = np.zeros(content.shape, np.uint8)
    for number, letter in enumerate((tile.letter for tile in own if tile.many), start=1):
        ground[content == ord(letter)] = number
    as_drawn += [
        is_tile.sum(axis=2) == 1,
        (content != ord(" ")).sum(axis=1) == len(letters) + (ground > 0).sum(axis=1),
        ground.any(axis=1) == bool(task.rules.grounds),
    ]
    tiles = is_tile.argmax(axis=2)
    if not all(each.all() for each in as_drawn):
        return None
    up = np.zeros((len(texts), height, width), np.bool_)
    right = np.zeros_like(up)
    up[:, :-1], right[:, :, :-1] = over == ord(" "), right_of == ord(" ")
    structures = Structures(height, width, *(each.reshape(len(texts), -1) for each in (up, right)))
    labyrinths = Labyrinths(structures, task, some[0].look, tiles, ground)
    return labyrinths if labyrinths.keep_the_rules() else None


def _canonical(text: str) -> Labyrinth | None:
    """Return the labyrinth of a text, or None if the text is not in the canonical form."""
    try:
        labyrinth = parse(text)
    except LabyrinthSyntaxError:
        return None
    return labyrinth if dump(labyrinth) == text else None


def dump_many(structures: Structures, start: int, goal: int, task: Task) -> list[str]:
    """Return `text.dump` of each structure with this start, goal and task, which has no tiles."""
    height, width = structures.height, structures.width
    text = dump(Labyrinth(Structure.without_walls(height, width), start, goal, task))
    _, above, beside = _indices(text, height, width)
    up, right = (each.reshape(-1, height, width) for each in (structures.up, structures.right))
    texts = np.tile(np.frombuffer(text.encode(), np.uint8), (len(structures), 1))
    texts[:, above] = np.where(up[:, :-1], ord(" "), ord("-"))
    texts[:, beside] = np.where(right[:, :, :-1], ord(" "), ord("|"))
    joined, length = texts.tobytes().decode(), len(text)
    return [joined[begin : begin + length] for begin in range(0, len(joined), length)]


def _indices(text: str, height: int, width: int) -> list[NDArray[np.int64]]:
    """Return the indices in a canonical text of its cells and passages, the lowest row first.

    Cells have the shape (height, width), passages above them (height - 1, width), and passages on
    their right (height, width - 1).
    """
    indices = np.arange(len(text))[text.index("-----") : text.index("end")]
    indices = indices.reshape(2 * height + 1, 4 * width + 2)[::-1]
    return [indices[1::2, 2::4], indices[2:-1:2, 2::4], indices[1::2, 4:-2:4]]
