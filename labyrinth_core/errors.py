"""`DatasetError`, messages in one line, and text for a terminal that strangers cannot control."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MALFORMED = (ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""Exceptions that malformed JSON may raise in code that uses it without checking it first."""


class DatasetError(RuntimeError):
    """A dataset is missing, unfinished, damaged, or not the one requested."""


def one_line(error: BaseException) -> str:
    """Return the message of an error in one line, or its type if there is no message."""
    try:
        message = " ".join(str(error).split())
    except Exception:  # The error class of other code, such as a policy.
        message = ""
    return message or type(error).__name__


@contextmanager
def naming(path: Path, temporary: Path | None = None) -> Iterator[None]:
    """Put a path into an OSError that names no file, as for a full disk, or `temporary`."""
    try:
        yield
    except OSError as error:
        if error.filename in (None, str(temporary)):
            error.filename = str(path)
        raise


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
