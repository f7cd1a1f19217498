"""Errors of the Hugging Face Hub: which calls are retried, and what the user is told.

The client retries some of its calls after a server error; the others are retried here.
"""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from json import JSONDecodeError
from typing import TypeVar

from huggingface_hub import constants, errors
from huggingface_hub.errors import HfHubHTTPError, HTTPError  # type: ignore[attr-defined]

from labyrinth_core.data.errors import DatasetError, one_line

WAITS = (0.2, 1.0, 3.0)
"""Seconds before each retry of a call, after a server or network error."""

FAULTS = (HTTPError, JSONDecodeError)
"""What the client raises for such an error; the second if it parses an error page as JSON."""

UNUSABLE = (HTTPError, ConnectionError, errors.FileMetadataError)
"""What the client alone raises for calls that cannot succeed."""

NO_TOKEN: type[Exception] = getattr(errors, "OIDCError", PermissionError)
"""What the client raises, since version 1.19, if a job cannot prove its identity to the Hub."""

Result = TypeVar("Result")


class PublishError(DatasetError):
    """A release failed; the message has one line."""


def is_passing(error: Exception) -> bool:
    """Return whether a retry may succeed: after a network or server error, or a rate limit."""
    status = status_of(error)
    return status is None or status >= 500 or status in (408, 429)


def repeated(
    call: Callable[[], Result],
    faults: tuple[type[Exception], ...] = FAULTS,
    may_pass: Callable[[Exception], bool] = is_passing,
) -> Result:
    """Return the result of an idempotent call, retried after temporary errors."""
    for seconds in WAITS:
        try:
            return call()
        except faults as error:
            if not may_pass(error):
                raise
        time.sleep(seconds)
    return call()


def status_of(error: Exception) -> int | None:
    """Return the status of the Hub's answer, None if there was no answer."""
    response = getattr(error, "response", None)
    status: int | None = getattr(response, "status_code", None)
    return status


@contextmanager
def explained(repo_id: str) -> Iterator[None]:
    """Turn an error of the client into one line that says what to do.

    Raises:
        PublishError: The client raised an error.
    """
    try:
        yield
    except DatasetError:
        raise
    except (*UNUSABLE, NO_TOKEN) as error:
        raise PublishError(_explanation(error, repo_id)) from error
    except (ValueError, RuntimeError) as error:  # A failed upload of contents raises the second.
        if not _is_of_client(error):
            raise
        raise PublishError(_explanation(error, repo_id)) from error


def _is_of_client(error: Exception) -> bool:
    """Return whether the Hub's client, or code that it calls, raised an error."""
    frames = traceback.walk_tb(error.__traceback__)
    modules = (str(frame.f_globals.get("__name__", "")) for frame, _ in frames)
    return any(module.partition(".")[0] == "huggingface_hub" for module in modules)


def _explanation(error: Exception, repo_id: str) -> str:
    if isinstance(error, NO_TOKEN) or (
        isinstance(error, HfHubHTTPError) and error.response.url.path == "/oauth/token"
    ):
        resource = os.environ.get("HF_OIDC_RESOURCE", "")
        return f"HF_OIDC_RESOURCE={resource}: the Hub gives this job no token: {one_line(error)}"
    if isinstance(error, HfHubHTTPError):
        status = status_of(error)
        return reasons(repo_id).get(status, f"the Hub answers {status}: {one_line(error)}")
    if isinstance(error, ValueError):
        return f"the Hub's client refuses: {one_line(error)}"
    reason = one_line(error.__cause__ or error)
    return f"{constants.ENDPOINT} does not answer as it should: {reason}"


def reasons(repo_id: str) -> dict[int | None, str]:
    """Return the message for the user by the HTTP status of an answer."""
    return {
        401: "the Hub rejects the token: make a new one, and set HF_TOKEN or run `hf auth login`",
        403: f"the token may not write to {repo_id}: use one with write access",
        404: f"{repo_id} does not exist, or this token may not see it",
        409: f"the Hub reports a conflict for {repo_id}: publish again",
        412: f"{repo_id} got another commit meanwhile, and nothing was changed: look at that "
        "commit, and publish again",
    }
