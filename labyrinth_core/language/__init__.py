"""The text language of labyrinths and other formats: parsing, dumping and drawing.

Text from strangers is parsed with limits; errors name line and column.
"""

from typing import TYPE_CHECKING

from labyrinth_core.doors import door

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from labyrinth_core.language.collection import Collection as Collection
    from labyrinth_core.language.drawing import describe as describe
    from labyrinth_core.language.drawing import draw_text as draw_text
    from labyrinth_core.language.edge_list import parse_edges as parse_edges
    from labyrinth_core.language.source_text import LabyrinthSyntaxError as LabyrinthSyntaxError
    from labyrinth_core.language.source_text import parse_size as parse_size
    from labyrinth_core.language.source_text import read_text as read_text
    from labyrinth_core.language.text import SETTINGS_OF as SETTINGS_OF
    from labyrinth_core.language.text import dump as dump
    from labyrinth_core.language.text import dump_many as dump_many
    from labyrinth_core.language.text import labyrinth_id as labyrinth_id
    from labyrinth_core.language.text import load as load
    from labyrinth_core.language.text import parse as parse
    from labyrinth_core.language.text import parse_many as parse_many
    from labyrinth_core.language.text import parse_sketch as parse_sketch
else:
    __getattr__, __dir__ = door(
        __name__,
        {
            "collection": ("Collection",),
            "drawing": ("describe", "draw_text"),
            "edge_list": ("parse_edges",),
            "source_text": ("LabyrinthSyntaxError", "parse_size", "read_text"),
            "text": (
                "SETTINGS_OF",
                "dump",
                "dump_many",
                "labyrinth_id",
                "load",
                "parse",
                "parse_many",
                "parse_sketch",
            ),
        },
    )
