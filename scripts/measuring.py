"""Shared code of the benchmarks: options, timing in turns, ratios and their table."""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from typing import NamedTuple, TypeVar

RUN = Path(__file__).resolve().parents[1] / "run.py"

Name = TypeVar("Name")
Result = TypeVar("Result")


def parser_of(description: str, rounds: int) -> argparse.ArgumentParser:
    """Return a parser with the options `--rounds` and `--quick`."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument(
        "--rounds", type=positive, default=rounds, help="rounds; each times everything once"
    )
    parser.add_argument("--quick", action="store_true", help="less work, for a quick look")
    return parser


def positive(text: str) -> int:
    """Return a positive integer.

    Raises:
        ArgumentTypeError: The text is not a positive integer.
    """
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text}: give a whole number, 1 or more")
    return int(text)


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


def cpu_seconds(work: Callable[[], object]) -> float:
    """Return the CPU seconds of a call, over all threads of this process."""
    start = time.process_time()
    work()
    return time.process_time() - start


def per_second(
    work: Callable[[], int], clock: Callable[[], float] = time.process_time
) -> Callable[[], float]:
    """Return a function that calls `work`, and returns the count that it returns, per second."""

    def rate() -> float:
        start = clock()
        return work() / (clock() - start)

    return rate


def forget() -> None:
    """Clear the caches of all our functions, as in a new process."""
    for name, module in list(sys.modules.items()):
        if name.startswith(("labyrinth_core", "pipeline")):
            for value in list(vars(module).values()):
                if hasattr(value, "cache_clear"):
                    value.cache_clear()


class Cost(NamedTuple):
    """The cost of a command."""

    seconds: float
    """Wall-clock time."""
    cpu: float
    """CPU seconds of the process and of the workers that it waited for."""
    memory: int
    """The largest peak resident set among these processes, in MiB."""


def run_command(*options: str) -> Cost:
    """Run `run.py` with options in a new process, and return its cost; exit if it fails."""
    begun = time.perf_counter()
    process = subprocess.Popen([sys.executable, str(RUN), *options], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if status:
        sys.exit(f"run.py {' '.join(options)}: exit status {process.returncode}")
    seconds = time.perf_counter() - begun
    return Cost(seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss >> 10)


def take_turns(
    contestants: Mapping[Name, Callable[[], Result]], rounds: int
) -> dict[Name, list[Result]]:
    """Call every contestant once in each round; return the results by name.

    Contestants take turns so that a busy machine slows all of them alike. An extra first round, in
    which libraries are imported and caches filled, does not count.
    """
    results: dict[Name, list[Result]] = {name: [] for name in contestants}
    for _ in range(rounds + 1):
        for name, contestant in contestants.items():
            results[name].append(contestant())
    return {name: of_one[1:] for name, of_one in results.items()}


def ratio(ours: Sequence[float], theirs: Sequence[float]) -> tuple[str, str]:
    """Return the median and the range of the rounds' ratios."""
    ratios = [a / b for a, b in zip(ours, theirs, strict=True)]
    return f"{median(ratios):,.1f}", f"{min(ratios):,.1f} - {max(ratios):,.1f}"


def report(rates: Mapping[str, Sequence[float]], rivals: Mapping[str, str], unit: str) -> None:
    """Print a table of median rates, with the ratios to their rivals and the range of these.

    Args:
        rates: Name -> the rate in each round.
        rivals: Name -> the name of its rival; names without a rival get no ratio.
        unit: The heading of the rates.
    """
    print(f"{'':38}{unit:>20}{'times':>12}{'range':>20}")
    for name, measured in rates.items():
        line = f"{name:38}{median(measured):>20,.0f}"
        if name in rivals:
            middle, extent = ratio(measured, rates[rivals[name]])
            line += f"{middle:>12}{extent:>20}"
        print(line)
