"""Terminal output: lines, tables and progress bars."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from math import ceil
from threading import Event, Thread
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from labyrinth_core.errors import printable

Item = TypeVar("Item")


SECONDS_PER_LINE = 60.0
"""The time between two lines about a long stage where there is no terminal."""


class _Console(Console):
    """A console that escapes control characters, which names of files and methods may hold."""

    def render_str(self, text: str, *args: Any, **options: Any) -> Text:
        """Return a line, or a cell of a table, with its control characters escaped."""
        return super().render_str(printable(text), *args, **options)


console = _Console(markup=False, emoji=False)


_said: set[str | Table] = set()
"""The lines that this process has printed with `once`."""


def say(what: str | Table, *, once: bool = False) -> None:
    """Print a line as it is, neither coloured nor wrapped, or a table.

    Args:
        what: The line or the table.
        once: Whether to print nothing if this process has printed the same with `once` already.
    """
    if once and what in _said:
        return
    if once:
        _said.add(what)
    if isinstance(what, str):
        console.print(what, highlight=False, soft_wrap=True)
    else:
        console.print(what)


class Bars(Progress):
    """Progress bars, with a line a minute where there is no terminal."""

    @contextmanager
    def each_minute(
        self, bar: TaskID, unit: str = "", spent: Callable[[], float] | None = None
    ) -> Iterator[None]:
        """Print a line a minute about a bar where there is no terminal, and so no bar.

        It says what the bar describes, how far it is, and the time left. A log of hours then shows
        that the program works, also while one item takes minutes.

        Args:
            bar: One of the bars.
            unit: What the bar counts, after a space.
            spent: Returns the seconds that the finished items took; None if the bar
                began with none.
        """
        if console.is_terminal:
            yield
            return
        ended = Event()

        def tell() -> None:
            while not ended.wait(SECONDS_PER_LINE):
                task = next(task for task in self.tasks if task.id == bar)
                total = task.total or 0
                line = f"{task.description}: {task.completed:,.0f} of {total:,.0f}{unit}"
                seconds = spent() if spent is not None else task.elapsed
                if seconds and task.completed:
                    remaining = timedelta(
                        seconds=ceil(seconds / task.completed * (total - task.completed))
                    )
                    line += f", {remaining} left"
                say(line)

        teller = Thread(target=tell, daemon=True)
        teller.start()
        try:
            yield
        finally:
            ended.set()
            teller.join()


def progress(*, vanishes: bool = False) -> Bars:
    """Return a context manager that shows the progress bars of a stage.

    Args:
        vanishes: Whether to show them only in a terminal, and remove them at the end.
    """
    return Bars(
        TextColumn("{task.description:>9}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=vanishes,
        disable=vanishes and not console.is_terminal,
    )


def tracked(
    items: Iterable[Item],
    description: str,
    total: int,
    amount: Callable[[Item], int] = lambda _: 1,
) -> Iterator[Item]:
    """Yield items under a bar that fills as the amounts of finished ones reach a total.

    Args:
        items: The items.
        description: What the bar says.
        total: The amount of all items.
        amount: Returns the amount of one item; by default, items are counted.
    """
    with progress(vanishes=True) as bars:
        bar = bars.add_task(description, total=total)
        with bars.each_minute(bar):
            for item in items:
                yield item
                bars.advance(bar, amount(item))
