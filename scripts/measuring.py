"""What the benchmarks share: a description of the machine, rounds of turns, and ratios."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from statistics import median
from typing import TypeVar

Name = TypeVar("Name")
Result = TypeVar("Result")


def machine(*libraries: str) -> str:
    """Return a description of the machine and the versions of Python and installed libraries."""
    parts = [f"{platform.system()} {platform.machine()}", f"{os.cpu_count()} cores"]
    parts.append(f"Python {platform.python_version()}")
    for name in libraries:
        try:
            parts.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return ", ".join(parts)


def take_turns(
    contestants: Mapping[Name, Callable[[], Result]], rounds: int
) -> dict[Name, list[Result]]:
    """Call every contestant once in each round, and return the results of each.

    They take turns so that a busy machine slows all of them alike. An additional first round, in
    which libraries are imported and caches filled, does not count.
    """
    results: dict[Name, list[Result]] = {name: [] for name in contestants}
    for _ in range(rounds + 1):
        for name, contestant in contestants.items():
            results[name].append(contestant())
    return {name: of_one[1:] for name, of_one in results.items()}


def ratio(ours: Sequence[float], theirs: Sequence[float], target: float) -> tuple[str, str, str]:
    """Return the median of the rounds' ratios, their range, and the target if it is not 0."""
    ratios = [a / b for a, b in zip(ours, theirs, strict=True)]
    verdict = f"{target:,}" + ("" if median(ratios) >= target else " MISSED") if target else ""
    return f"{median(ratios):,.1f}", f"{min(ratios):,.1f} - {max(ratios):,.1f}", verdict
