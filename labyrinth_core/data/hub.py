"""What holds for each call of the Hub's client: a limit on silence, and a token that can be sent.

A call fails after a minute without a byte. The client limits downloads itself
(HF_HUB_DOWNLOAD_TIMEOUT, HF_HUB_ETAG_TIMEOUT), but not most other calls. It retries calls that
fail, so a silent Hub becomes an error after some minutes.
"""

from __future__ import annotations

import os
from typing import Any

from huggingface_hub import get_session, get_token
from huggingface_hub.errors import HTTPError  # type: ignore[attr-defined]

from labyrinth_core.data.errors import DatasetError

VARIABLE, SECONDS = "LABYRINTH_HUB_SECONDS", "60"
"""Environment variable for the seconds without a byte after which a call fails; its default."""

UNAVAILABLE = (OSError, ValueError, HTTPError, RuntimeError)
"""The client's errors for a file or repository that it cannot provide; RuntimeError is Xet's."""


def prepare_client() -> None:
    """Set a time limit for calls of the Hub's client that have none, and check the token.

    Raises:
        DatasetError: The environment variable is not a positive number of seconds, or the token
            cannot be sent; an error of the client's own would print it.
    """
    _seconds()
    # With HF_OIDC_RESOURCE the Hub itself gives a job its token, at the first call that needs it.
    token = "" if os.environ.get("HF_OIDC_RESOURCE") else get_token() or ""
    if not (token.isascii() and token.isprintable()):
        raise DatasetError(
            "the Hub token is malformed, with characters that no token has: copy it again into "
            "HF_TOKEN, or run `hf auth login`"
        )
    session = get_session()
    hooks = session.event_hooks
    if _limit not in hooks["request"]:
        session.event_hooks = hooks | {"request": [*hooks["request"], _limit]}


def _limit(request: Any) -> None:
    """Give a request of httpx the limit, unless it has one."""
    limits = request.extensions["timeout"]
    if not any(limits.values()):
        request.extensions["timeout"] = dict.fromkeys(limits, _seconds())


def _seconds() -> float:
    text = os.environ.get(VARIABLE, SECONDS)
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0 < seconds < 1e6:
        raise DatasetError(f"{VARIABLE}={text:.60}: give a number of seconds, such as {SECONDS}")
    return seconds
