"""The progress bars."""

from __future__ import annotations

from threading import Event

import pytest

from pipeline.machinery import console


def test_a_bar_fills_by_the_amounts_of_finished_items(monkeypatch: pytest.MonkeyPatch) -> None:
    bars = console.Bars(disable=True)
    monkeypatch.setattr(console, "progress", lambda **_: bars)
    items = ["a" * 4, "b" * 16]
    found = console.tracked(items, "count", 20, len)
    assert [(item, bars.tasks[0].completed) for item in found] == [(items[0], 0), (items[1], 4)]
    assert bars.tasks[0].completed == 20


def test_a_log_without_a_terminal_gets_a_line_a_minute(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now, minutes = 0.0, [False, False, True]

    class Minutes(Event):
        """A minute is over at once, and the third wait is the end."""

        def wait(self, timeout: float | None = None) -> bool:
            nonlocal now
            now += timeout or 0
            return minutes.pop(0)

    monkeypatch.setattr(console, "Event", Minutes)
    bars = console.Bars(disable=True, get_time=lambda: now)
    bar = bars.add_task("loss 0.5, best SR 48%", total=100)
    with bars.each_minute(bar, " epochs"):
        pass
    bars.update(bar, completed=60)
    minutes[:] = [False, True]
    with bars.each_minute(bar, " epochs"):
        pass
    minutes[:] = [False, True]
    with bars.each_minute(bar, " epochs", lambda: 30.0):
        pass
    assert capsys.readouterr().out.splitlines() == [
        *["loss 0.5, best SR 48%: 0 of 100 epochs"] * 2,
        "loss 0.5, best SR 48%: 60 of 100 epochs, 0:02:40 left",
        "loss 0.5, best SR 48%: 60 of 100 epochs, 0:00:20 left",
    ]
    monkeypatch.setattr(console.console, "_force_terminal", True)
    minutes[:] = [False, True]
    with bars.each_minute(bar):
        pass
    assert capsys.readouterr().out == ""
