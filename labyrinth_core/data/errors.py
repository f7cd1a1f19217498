"""The error of a dataset, and the errors of libraries in one line."""

from __future__ import annotations


class DatasetError(RuntimeError):
    """A dataset that is missing, unfinished, damaged, or another one than asked for."""


def one_line(error: BaseException) -> str:
    """Return what an error of a library says, in one line; its kind if it says nothing."""
    return " ".join(str(error).split()) or type(error).__name__
