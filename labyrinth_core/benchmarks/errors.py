"""Errors of `certify` that its user can mend, and errors of the environment itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from labyrinth_core.errors import one_line

FAILURES = (Exception, SystemExit)
"""What the code of others may raise, which is not a failure of ours."""


class CertifyError(ValueError):
    """A benchmark cannot be certified as asked; the message is one line that says why."""


class EnvironmentFailure(Exception):  # noqa: N818  An error of the environment, not of ours.
    """An environment raised an error or returned what it may not; the message is one line."""


def called(function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """Call code of others and return its result.

    Raises:
        EnvironmentFailure: The call raised an error, which is the cause, or ended the program.
    """
    try:
        return function(*arguments, **named)
    except (CertifyError, EnvironmentFailure):
        raise
    except FAILURES as error:
        raise failure(error) from error


def failure(error: BaseException) -> EnvironmentFailure:
    """Return an error of an environment as its failure."""
    return EnvironmentFailure(f"{type(error).__name__}: {one_line(error):.200}")
