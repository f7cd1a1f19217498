"""Time limit for calls of the Hub's client: a minute without a byte.

The client limits downloads itself (HF_HUB_DOWNLOAD_TIMEOUT, HF_HUB_ETAG_TIMEOUT), but not most
other calls. It retries calls that fail, so a silent Hub becomes an error after some minutes.
"""

from __future__ import annotations

import os
from typing import Any

from huggingface_hub import get_session
from huggingface_hub.errors import HTTPError  # type: ignore[attr-defined]

from labyrinth_core.data.errors import DatasetError

VARIABLE, SECONDS = "LABYRINTH_HUB_SECONDS", "60"
"""Environment variable for the seconds without a byte after which a call fails; its default."""

UNAVAILABLE = (OSError, ValueError, HTTPError, RuntimeError)
"""The client's errors for a file or repository that it cannot provide; RuntimeError is Xet's."""


def limit_silence() -> None:
    """Set a time limit for calls of the Hub's client that have none.

    Raises:
        DatasetError: The environment variable is not a positive number of seconds.
    """
    _seconds()
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
