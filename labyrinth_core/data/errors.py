"""The error of unusable datasets, and the texts of other errors in one line."""

from __future__ import annotations

MALFORMED = (ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""What may be raised where JSON from a file is used as if it were as it should be."""


class DatasetError(RuntimeError):
    """A dataset is missing, unfinished, damaged, or another than asked for."""


def one_line(error: BaseException) -> str:
    """Return the message of an error in one line, or its type if there is no message."""
    try:
        message = " ".join(str(error).split())
    except Exception:  # An error of a stranger's program, such as a policy.
        message = ""
    return message or type(error).__name__


def lacks_memory(error: BaseException) -> bool:
    """Return whether an error, or one that caused it, says that there is not enough memory.

    A library that cannot be loaded, a thread that cannot be started and a compressor have other
    types; Arrow's error is a MemoryError. The cause of an error of a worker is a text.
    """
    signs = (
        "failed to map segment",
        "allocate memory",
        "Allocation error",
        "can't start new thread",
        "launch worker thread",
        "malloc of size",
        "MemoryError",
    )
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError) or any(sign in str(cause) for sign in signs):
            return True
        cause = cause.__cause__ or cause.__context__
    return False
