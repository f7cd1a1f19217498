"""Reading texts: lines without comments, errors that show their place, and sizes.

The text language and the lists of edges share this module.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO, NoReturn

from labyrinth_core.errors import printable_line
from labyrinth_core.world import SIDES, LabyrinthError

MAX_TEXT = 32 * 1024 * 1024
"""The most characters of a text, or bytes of a file; the largest drawing has a quarter of that."""

_QUOTES = '"""'
_WINDOW = 94
"""Longest part of a source line that a message shows, in characters."""


@dataclass(eq=False, repr=False)
class LabyrinthSyntaxError(LabyrinthError):
    """The text is not a labyrinth; the message shows the line, with a caret below the error."""

    message: str
    """What is wrong, in a few words."""
    file: str | None
    """The name of the file, or None if the text does not come from a file."""
    line: int
    """The line of the error, from 1."""
    column: int
    """The column of the error, from 1."""
    source_line: str
    """The text of that line."""
    expected: str | None = None
    """What the language allows at this place."""
    found: str | None = None
    """What the text has at this place."""
    cell: int | None = None
    """Always None: the error is at a place of the text."""

    @classmethod
    def at(
        cls,
        text: str,
        offset: int,
        message: str,
        file: str | None,
        expected: str | None = None,
        found: str | None = None,
    ) -> LabyrinthSyntaxError:
        """Return the error at an offset of a text."""
        begin = text.rfind("\n", 0, offset) + 1
        source_line = text[begin:].partition("\n")[0]
        line, column = text.count("\n", 0, offset) + 1, offset - begin + 1
        return cls(message, file, line, column, source_line, expected, found)

    def __str__(self) -> str:
        file = printable_line(self.file or "<text>")  # A file name can hold any character.
        message = f"{file}:{self.line}:{self.column}: {self.message}"
        if self.expected is not None:
            message += f": expected {self.expected}"
        if self.found is not None:
            message += f", found {self.found}"
        source, column = self.source_line, self.column - 1
        start = max(0, min(column - _WINDOW // 2, len(source) - _WINDOW))
        before = "..." if start else ""
        after = "..." if start + _WINDOW < len(source) else ""
        shown = source[start : start + _WINDOW]
        harmless = "".join(char if char.isprintable() else "?" for char in shown)  # Aligned.
        caret = " " * (len(before) + column - start) + "^"
        return f"{message}\n{before}{harmless}{after}\n{caret}"


class Source:
    """A text that is read line by line, without its comments."""

    def __init__(self, text: str, file: str | None) -> None:
        '''Remove the comments of a text, but not the line breaks inside them.

        comment = '"""' {any character} '"""'
        '''
        self.original = with_line_feeds(text, file)
        self.file = file
        self.position = 0
        self.kept: list[tuple[int, int]] = []
        """The offset of each piece between and inside comments, in `text` and in `original`."""
        pieces = self.original.split(_QUOTES)
        if len(pieces) % 2 == 0:
            opening = len(self.original) - len(pieces[-1]) - len(_QUOTES)
            expected, found = 'another """ after this one', "the end of the text"
            raise LabyrinthSyntaxError.at(
                self.original, opening, "a comment is not closed", file, expected, found
            )
        length = position = 0
        for number, piece in enumerate(pieces):
            is_comment = number % 2 == 1
            self.kept.append((length, position - len(_QUOTES) if is_comment else position))
            position += len(piece) + len(_QUOTES)
            if is_comment:
                pieces[number] = "\n" * piece.count("\n")
            length += len(pieces[number])
        self.text = "".join(pieces)
        self.lines = iter(self.text.split("\n"))

    def next_line(self) -> tuple[int, str]:
        """Return offset and text, without trailing blanks, of the next line that is not blank.

        After the last line the text is empty.
        """
        for line in self.lines:
            begin = self.position
            self.position += len(line) + 1
            if shown := line.rstrip(" "):
                return begin, shown
        return len(self.text), ""

    def original_offset(self, offset: int) -> int:
        """Return the offset in `original` of an offset in the text without comments."""
        if offset >= len(self.text):
            return len(self.original)
        kept, original = self.kept[bisect_right(self.kept, offset, key=itemgetter(0)) - 1]
        return original + offset - kept

    def line_number(self, offset: int) -> int:
        """Return the line number, from 1, of an offset in the text without comments."""
        return self.original.count("\n", 0, self.original_offset(offset)) + 1

    def fail(
        self, offset: int, message: str, expected: str | None = None, found: str | None = None
    ) -> NoReturn:
        """Raise the error at an offset of the text without comments.

        A control character in the same line is the likelier cause, so it is reported instead.
        """
        begin = self.text.rfind("\n", 0, offset) + 1
        line = self.text[begin:].partition("\n")[0]
        for column, char in enumerate(line):
            if not char.isprintable():
                offset = begin + column
                message = "tabs and other control characters are allowed only in comments"
                expected, found = "blanks or printable characters", character_at(line, column)
                break
        raise self.error(offset, message, expected, found)

    def error(
        self, offset: int, message: str, expected: str | None = None, found: str | None = None
    ) -> LabyrinthSyntaxError:
        """Return the error at an offset of the text without comments."""
        if expected is not None and found is None:
            found = character_at(self.text, offset)
        original = self.original_offset(offset)
        return LabyrinthSyntaxError.at(self.original, original, message, self.file, expected, found)


def character_at(text: str, offset: int) -> str:
    """Return the character at an offset of a text, in words."""
    char = text[offset : offset + 1]
    names = {"": "the end of the text", "\n": "the end of the line", " ": "a blank", "\t": "a tab"}
    if char in names:
        return names[char]
    return repr(char) if char.isprintable() else f"the character U+{ord(char):04X}"


def quoted(text: str) -> str:
    """Return a word or line in quotation marks, cut to 30 characters."""
    if not text:
        return "the end of the text"
    return repr(text[:30]) + ("..." if len(text) > 30 else "")


def with_line_feeds(text: str, file: str | None) -> str:
    """Return a text with line feeds as line breaks and without a byte order mark.

    Raises:
        LabyrinthSyntaxError: The text is too long.
    """
    if len(text) > MAX_TEXT:
        start = text[:_WINDOW]
        expected, found = f"at most {MAX_TEXT:,} characters", f"{len(text):,}"
        raise LabyrinthSyntaxError.at(start, 0, "the text is too long", file, expected, found)
    return text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")


def read_text(file: Path | BinaryIO, name: str | None = None) -> str:
    """Return the text of a UTF-8 file, of which at most `MAX_TEXT` + 1 bytes are read.

    Args:
        file: Its path, or an open stream of bytes.
        name: Its name for messages; None for the path.

    Raises:
        LabyrinthSyntaxError: The file is too long, or not UTF-8.
        OSError: The file cannot be read.
    """
    if isinstance(file, Path):
        with file.open("rb") as stream:
            return read_text(stream, name or str(file))
    return decode(file.read(MAX_TEXT + 1), name)


def decode(data: bytes, file: str | None) -> str:
    """Decode bytes as UTF-8.

    Raises:
        LabyrinthSyntaxError: There are too many bytes, or they are not UTF-8.
    """
    if len(data) > MAX_TEXT:
        start = data[:_WINDOW].decode(errors="replace")
        expected, found = f"at most {MAX_TEXT:,} bytes", "more"
        raise LabyrinthSyntaxError.at(start, 0, "the file is too long", file, expected, found)
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        before = with_line_feeds(data[: error.start].decode(), file)
        rest = data[error.start : error.start + _WINDOW].decode(errors="replace")
        found = f"the byte 0x{data[error.start]:02x}"
        raise LabyrinthSyntaxError.at(
            before + rest, len(before), "the file is not text", file, "UTF-8", found
        ) from error


def parse_size(text: str) -> tuple[int, int]:
    """Return `(height, width)` of a size written as `5` or `4x6`.

    Raises:
        ValueError: The text is not an integer from 2 to 1,000, or two of them joined by an x.
    """
    match = re.fullmatch(r"\s*(\d{1,5})(?:\s*[xX]\s*(\d{1,5}))?\s*", text, re.ASCII)
    sides = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
    if not all(side in SIDES for side in sides):
        raise ValueError(
            f"size={text}: give a whole number from {SIDES[0]} to {SIDES[-1]:,} such as 5, "
            "or height x width such as 4x6"
        )
    return sides
