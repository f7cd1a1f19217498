"""Errors of the Hub while publishing, in one line that says what to do."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from huggingface_hub import HfApi, constants, errors, get_token
from huggingface_hub.errors import HfHubHTTPError

from labyrinth_core import hub
from labyrinth_core.errors import DatasetError, one_line
from pipeline.machinery import say

NO_TOKEN: type[Exception] = getattr(errors, "OIDCError", PermissionError)
"""What the client raises, since version 1.19, if a job cannot prove its identity to the Hub."""


class PublishError(DatasetError):
    """A release failed; the message has one line."""


def is_unseen(api: HfApi, repo_id: str) -> bool:
    """Return whether a dry run cannot query the Hub, such as without a token, and print why."""
    reason = "" if get_token() else "there is no token"
    try:
        if not reason:
            hub.repeated(lambda: api.repo_exists(repo_id))
    except (*hub.UNAVAILABLE, NO_TOKEN) as error:
        if not isinstance(error, hub.WrongAnswerError) and hub.status_of(error) is None:
            reason = f"{constants.ENDPOINT} does not answer: {one_line(error)}"
    if reason:
        say(
            f"cannot query the Hub ({reason}), so the plan is for a new repository; "
            "scripts/local_hub starts a Hub on this machine, for rehearsals."
        )
    return bool(reason)


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
    except Exception as error:
        if not isinstance(error, (hub.WrongAnswerError, NO_TOKEN)) and not hub.is_of_client(error):
            raise
        raise PublishError(_explanation(error, repo_id)) from error


def _explanation(error: Exception, repo_id: str) -> str:
    if isinstance(error, NO_TOKEN) or (
        isinstance(error, HfHubHTTPError) and error.response.url.path == "/oauth/token"
    ):
        resource = os.environ.get("HF_OIDC_RESOURCE", "")
        return f"HF_OIDC_RESOURCE={resource}: the Hub gives this job no token: {one_line(error)}"
    status = hub.status_of(error)
    if status == 412:  # Not of a commit, which says what happened itself.
        return hub.reason_of(error)
    if status is not None:
        return reasons(repo_id).get(status, hub.reason_of(error))
    if isinstance(error, hub.WrongAnswerError):
        return hub.reason_of(error)
    if isinstance(error, ValueError):
        return f"the Hub's client refuses: {one_line(error)}"
    return f"{constants.ENDPOINT} does not answer as it should: {hub.reason_of(error)}"


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
