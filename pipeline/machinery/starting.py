"""What a terminal shows while libraries are imported, which takes seconds."""

from __future__ import annotations

import sys

_NOTICE = "starting ..."


def show_start(*, started: bool = False) -> None:
    """Show that the program starts, in a line that what comes next replaces; or remove it."""
    if sys.stderr is not None and sys.stderr.isatty():
        shown = " " * len(_NOTICE) if started else _NOTICE
        sys.stderr.write(f"{shown}\r")
        sys.stderr.flush()
