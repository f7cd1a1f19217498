"""The progress bars."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from rich.progress import Progress

from pipeline.machinery import console
from pipeline.machinery.worker import count_done


def test_a_bar_moves_before_the_first_item_is_finished(monkeypatch: pytest.MonkeyPatch) -> None:
    bars = Progress(disable=True)
    monkeypatch.setattr(console, "progress", lambda **_: bars)
    shown = []

    def items() -> Iterator[tuple[int, str]]:
        count_done(4)
        for _ in range(1000):
            shown.append(bars.tasks[0].completed)
            if shown[-1]:
                break
            time.sleep(0.01)
        yield 10, "first"
        count_done(99)  # As when a lost worker's item was done by another.
        yield 10, "second"

    assert list(console.tracked(items(), "count", total=20)) == ["first", "second"]
    assert shown[-1] == 4
    assert bars.tasks[0].completed == 20
