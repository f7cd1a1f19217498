"""The error of unusable datasets, and the texts of other errors in one line."""

from __future__ import annotations

MALFORMED = (ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""What may be raised where JSON from a file is used as if it were as it should be."""


class DatasetError(RuntimeError):
    """A dataset is missing, unfinished, damaged, or not the one that was asked for."""


def one_line(error: BaseException) -> str:
    """Return the message of an error in one line, or its type if there is no message."""
    try:
        message = " ".join(str(error).split())
    except Exception:  # An error of another program, such as a policy.
        message = ""
    return message or type(error).__name__
