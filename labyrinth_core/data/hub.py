"""How long a call of the Hub's client may wait: a minute without a byte.

Downloads have a limit of the client's own (HF_HUB_DOWNLOAD_TIMEOUT, HF_HUB_ETAG_TIMEOUT), most
other calls none. The client repeats calls that fail: a silent Hub is given up after minutes.
"""

from __future__ import annotations

import os
from typing import Any

from huggingface_hub import get_session
from huggingface_hub.errors import HTTPError  # type: ignore[attr-defined]

from labyrinth_core.data.errors import DatasetError

VARIABLE, SECONDS = "LABYRINTH_HUB_SECONDS", "60"
"""The environment variable with the seconds without a byte that end a call, and its default."""

UNAVAILABLE = (OSError, ValueError, HTTPError, RuntimeError)
"""What the client raises for a file or a repository that it cannot provide; the last one: Xet's."""


def limit_silence() -> None:
    """Limit how long the calls of the Hub's client wait that have no limit.

    Raises:
        DatasetError: The environment variable holds no number of seconds.
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
