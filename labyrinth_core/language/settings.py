"""The settings above a drawing in the text language: the task and the look."""

from __future__ import annotations

import re
from typing import NamedTuple, NoReturn

from labyrinth_core.language.source_text import Source, quoted
from labyrinth_core.world.labyrinth import Labyrinth, Look, Task

SETTINGS = {
    "key_and_lock": Task.KEY_AND_DOOR,
    "icy_floor": Task.ICY_FLOOR,
    "occlusion": Task.PARTIAL_OBSERVABILITY,
}
"""Setting -> the task that it switches on, in the order in which `dump` writes them."""

_SETTINGS_OF = {
    task: "".join(f"{name}: {switched_on is task}\n" for name, switched_on in SETTINGS.items())
    for task in Task
}
"""The settings of each task as text."""

HEADING = "labyrinth"
"""The line that announces the drawing, without its colon."""

_LOOK = "look"
_SETTING = re.compile(r" *([^:]*)(:?) *(.*)")
_FIRST_WORD = re.compile(r" *([^ :]*) *(:?) *")

_LOOKS = tuple(map(str, Look))
_VALUES = dict.fromkeys(SETTINGS, re.compile("true|false")) | {
    _LOOK: re.compile("|".join(_LOOKS)),
}
"""The values that each setting may have, in small letters."""
_EXPECTED = dict.fromkeys(SETTINGS, "True or False") | {
    _LOOK: f"{', '.join(_LOOKS[:-1])} or {_LOOKS[-1]}",
}


class Settings(NamedTuple):
    """The settings above a drawing."""

    task: Task
    offset: int
    """Offset of the setting that switches the task on, or of the heading if none is on."""
    look: Look


def parse_settings(source: Source) -> Settings:
    """Return the settings above the drawing, and read on to it.

    setting = ("key_and_lock" | "icy_floor" | "occlusion") ":" ("True" | "False")
    look = "look" ":" ("plain" | "recoloured" | "thin_walls")
    """
    switched_on: tuple[Task, int] | None = None
    look = Look.PLAIN
    seen: dict[str, int] = {}
    while True:
        offset, line = source.next_line()
        match = _SETTING.match(line)
        assert match, "every part of the pattern may be empty"
        name, colon, value = match[1].rstrip(" "), match[2], match[3]
        place, value_at = offset + match.start(1), offset + match.start(3)
        if name == HEADING and colon and not value:
            return Settings(*(switched_on or (Task.NAVIGATION, place)), look)
        if name not in _VALUES or not colon:
            _refuse_setting(source, offset, line)
        if name in seen:
            expected = "each setting at most once"
            found = f"{name} again, after line {source.line_number(seen[name])}"
            source.fail(place, "a setting is given twice", expected, found)
        seen[name] = place
        if not _VALUES[name].fullmatch(value.lower()):
            found = quoted(value) if value else "the end of the line"
            source.fail(value_at, f"in the value of {name}", _EXPECTED[name], found)
        if name == _LOOK:
            look = Look(value.lower())
        elif value.lower() == "true":
            if switched_on:
                found = f"{name}, after line {source.line_number(switched_on[1])}"
                source.fail(place, "two tasks are switched on", "one task at most", found)
            switched_on = SETTINGS[name], place


def _refuse_setting(source: Source, offset: int, line: str) -> NoReturn:
    """Raise the error for a line before the drawing that is neither setting nor heading."""
    from difflib import get_close_matches

    match = _FIRST_WORD.match(line)
    assert match, "every part of the pattern may be empty"
    word, place = match[1], offset + match.start(1)
    if word in (HEADING, *_VALUES):
        if match[2]:
            message = "the drawing begins on a line of its own"
            source.fail(offset + match.end(), message, "the end of the line")
        source.fail(offset + match.end(), f"after {word}", "':'")
    if not line or line[0] in "-|":
        found = quoted(line.strip(" "))
        source.fail(place, "nothing announces the drawing", f"'{HEADING}:'", found)
    close = get_close_matches(word[:40].lower(), (HEADING, *_VALUES), n=1)
    hint = f" (did you mean {close[0]}?)" if close else ""
    expected = f"{', '.join(_VALUES)} or {HEADING}{hint}"
    source.fail(place, "unknown setting", expected, quoted(word or line.strip(" ")))


def dump_settings(labyrinth: Labyrinth) -> str:
    """Return the settings of a labyrinth as in its canonical text, a line each."""
    look = "" if labyrinth.look is Look.PLAIN else f"{_LOOK}: {labyrinth.look}\n"
    return f"{_SETTINGS_OF[labyrinth.task]}{look}"
