"""`DatasetError`, and the messages of other errors."""

from __future__ import annotations

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
