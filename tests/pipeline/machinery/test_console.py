"""The progress bars."""

from __future__ import annotations

import pytest
from rich.progress import Progress

from pipeline.machinery import console


def test_a_bar_fills_by_the_amounts_of_finished_items(monkeypatch: pytest.MonkeyPatch) -> None:
    bars = Progress(disable=True)
    monkeypatch.setattr(console, "progress", lambda **_: bars)
    items = [(4, "first"), (16, "second")]
    shown = [(item, bars.tasks[0].completed) for item in console.tracked(items, "count", 20)]
    assert shown == [("first", 0), ("second", 4)]
    assert bars.tasks[0].completed == 20
