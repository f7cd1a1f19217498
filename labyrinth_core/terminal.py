"""Text for a terminal, which text from strangers cannot control."""

from __future__ import annotations

import io
import os
import sys


def printable(text: str) -> str:
    """Escape the characters of a text that do not print, except line breaks, for a terminal.

    File names can hold any character, including those that colour or clear the screen.
    """
    return "".join(
        char if char.isprintable() or char == "\n" else ascii(char)[1:-1] for char in text
    )


def printable_line(text: str) -> str:
    """Escape all characters of a text that do not print, line breaks too, as in names of files."""
    return printable(text).replace("\n", "\\n")


def escape_output() -> None:
    """Make stdout and stderr escape what they cannot encode, so that no message fails.

    A stream that the shell closed (`>&-`) is reopened on the null device, also for child processes.
    """
    for number, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), number)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, "w"))
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
