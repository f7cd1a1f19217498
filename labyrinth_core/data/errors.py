"""`DatasetError`, and one-line messages of other errors."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

AGAIN = "build it again with the same command, or download it again"
"""Advice for a missing or damaged file of a dataset; a build makes such files again."""

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
def readable(place: object) -> Iterator[None]:
    """Turn a read error inside the block into a DatasetError that names `place`.

    Only calls of Arrow and of storage belong in the block. In code that works with their results,
    a bug would pass for a damaged file.
    """
    import pyarrow as pa

    try:
        yield
    except (MemoryError, GeneratorExit):
        # The files are fine. Arrow's MemoryError is an ArrowException, too; and when Python exits,
        # it closes unfinished streams (GeneratorExit) after Arrow's names are gone.
        raise
    except Exception as error:
        # Not imported here: without free file descriptors, the import would fail instead.
        hub = sys.modules.get("huggingface_hub.errors")
        of_hub = () if hub is None else (hub.HTTPError,)
        if isinstance(error, FileNotFoundError):
            raise DatasetError(f"{place} is missing: {AGAIN}") from error
        if isinstance(error, (OSError, ValueError, pa.ArrowException, *of_hub)):
            raise DatasetError(f"{place} cannot be read: {one_line(error)}") from error
        raise
