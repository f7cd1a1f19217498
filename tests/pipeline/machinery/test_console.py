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


def test_a_log_without_a_terminal_gets_a_line_a_minute(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    monkeypatch.setattr(
        console, "progress", lambda **_: Progress(disable=True, get_time=lambda: now)
    )
    for _ in console.tracked(((10, None) for _ in range(10)), "build", 100):
        now += 25
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "build: 30 of 100, 0:02:55 left",
        "build: 60 of 100, 0:01:40 left",
        "build: 90 of 100, 0:00:25 left",
    ]
    monkeypatch.setattr(console.console, "_force_terminal", True)
    for _ in console.tracked(((10, None) for _ in range(10)), "build", 100):
        now += 25
    assert "build" not in capsys.readouterr().out
