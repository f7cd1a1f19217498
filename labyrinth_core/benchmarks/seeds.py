"""Seeds of an environment: given as ranges, lists or texts such as `0:1000`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from operator import index

import numpy as np

from labyrinth_core.benchmarks.errors import CertifyError

Seeds = range | Sequence[int] | str
"""Seeds as a caller gives them."""

MOST = 10_000_000
"""The maximum number of seeds of a split."""


def seeds_of(given: object, name: str) -> tuple[int, ...]:
    """Return the seeds of a split, each once, in the order given.

    Args:
        given: A range, an iterable of whole numbers, or a text such as `0:1000,5000,0:10:2`.
        name: The name of the argument, for the message.

    Raises:
        CertifyError: The seeds are not whole numbers from 0 on, or there are none or too many.
    """
    allowed = "give seeds as a range, a list of whole numbers from 0 on, or a text such as 0:1000"
    refusal = CertifyError(f"{name}={given!s:.60}: {allowed}")
    try:
        if isinstance(given, str):
            parts: list[Sequence[int]] = [_part(part) for part in given.split(",")]
        elif isinstance(given, Iterable):
            parts = [given] if isinstance(given, range) else [[index(each) for each in given]]
        else:
            raise refusal
    except (TypeError, ValueError) as error:
        raise refusal from error
    count = sum(map(len, parts))
    if not 0 < count <= MOST:
        raise CertifyError(f"{name}={given!s:.60}: {count:,} seeds: give 1 to {MOST:,}")
    distinct = tuple(dict.fromkeys(seed for part in parts for seed in part))
    if min(distinct) < 0:
        raise refusal
    return distinct


def _part(text: str) -> range:
    numbers = re.fullmatch(r"\s*(\d+)(?::(\d+)(?::(\d+))?)?\s*", text, re.ASCII)
    if numbers is None:
        raise ValueError(text)
    first, end, step = numbers.groups()
    return range(int(first), int(first) + 1 if end is None else int(end), int(step or 1))


def evenly(seeds: Sequence[int], most: int) -> list[int]:
    """Return all seeds, or so many evenly chosen ones."""
    places = np.linspace(0, len(seeds) - 1, min(len(seeds), most)).astype(int)
    return [seeds[index] for index in places.tolist()]


def text_of(seeds: Sequence[int]) -> str:
    """Return seeds as the shortest text of single seeds and runs with step 1."""
    runs: list[list[int]] = []
    for seed in seeds:
        if runs and seed == runs[-1][1]:
            runs[-1][1] += 1
        else:
            runs.append([seed, seed + 1])
    return ",".join(f"{a}" if b == a + 1 else f"{a}:{b}" for a, b in runs)
