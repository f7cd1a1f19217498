"""Let commands run out of memory, interrupt others at random moments, and look at how they end.

    python scripts/end_matrix.py --runs 50 --interruptions 200

A command that gets too little memory (`ulimit -v`) builds a dataset with two workers, or validates,
analyses and describes one. Interruptions are SIGINT, half of them for the whole process group, as
by Ctrl-C in a terminal, the others for the first process alone. Before the first line of the
program Python ends in its own words; such ends are counted by themselves.

The exit status is 1 if a command does not end in time, has another exit status than 0, 1 or 130,
prints other than one line on standard error (none if it succeeds), or leaves a process.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

RUN = Path(__file__).parents[1] / "run.py"
BUILD = ("size=20", "workers=2", "stages=build")
DESCRIBE = ("size=20", "workers=2", "stages=[validate,analyse,card]")

LIMITS = (400, 500, 565, 590, 600, 610, 625, 650, 700, 800)
"""Megabytes; with fewer than 600 the program does not begin."""

TIME_TO_END = 240.0
"""The seconds in which a command has to end with all its processes, on a machine at work."""


@dataclass
class Ends:
    """How commands ended."""

    kinds: Counter[str] = field(default_factory=Counter)
    """What is shown of an end -> how many."""
    wrong: list[str] = field(default_factory=list)

    def note(self, what: str, kind: str, *, right: bool, stderr: str) -> None:
        """Count an end, and print it."""
        self.kinds[kind] += 1
        print(f"{what}: {kind}{'' if right else ' WRONG'}", flush=True)
        if not right:
            self.wrong.append(f"{what}: {kind}\n{stderr}")


def ended(
    folder: Path,
    arguments: tuple[str, ...],
    act: Callable[[int], None] = lambda _: None,
    limit: int | None = None,
) -> tuple[int | None, str]:
    """Run a command in a process group of its own, and return its exit status and errors.

    Args:
        folder: Where it runs.
        arguments: What follows `run.py`.
        act: Called with the id of the process as soon as it has been started.
        limit: The bytes of address space of each process.

    Returns:
        The exit status, None if the command or a process of it did not end in time; and what stood
        on standard error.
    """

    def limited() -> None:
        os.setpgid(0, 0)
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

    errors = folder / "errors"
    with errors.open("wb") as stderr:
        process = subprocess.Popen(
            [sys.executable, str(RUN), *arguments],
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            preexec_fn=limited,
        )
    act(process.pid)
    until, status = time.monotonic() + TIME_TO_END, None
    with suppress(subprocess.TimeoutExpired):
        status = process.wait(TIME_TO_END)
    with suppress(ProcessLookupError):
        while time.monotonic() < until:
            os.killpg(process.pid, 0)
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGKILL)
        status = None
    process.wait()
    return status, errors.read_text(encoding="utf-8", errors="replace")


def kind_of(status: int | None, stderr: str) -> str:
    """Return what is counted of an end."""
    lines = [line for line in stderr.splitlines() if line.strip()]
    said = lines[0][:60] if len(lines) == 1 else f"{len(lines)} lines"
    return f"status {status}, {said}" if lines else f"status {status}"


def run_out_of_memory(made: Path, folder: Path, given: argparse.Namespace, ends: Ends) -> None:
    """Run commands under limits of memory."""
    for number in range(given.runs):
        megabytes = given.megabytes[number % len(given.megabytes)]
        arguments = (BUILD, DESCRIBE)[number // len(given.megabytes) % 2]
        if arguments is DESCRIBE:
            shutil.copytree(made, folder / "data")
        dataset = f"labyrinths={given.labyrinths}"
        status, stderr = ended(folder, (*arguments, dataset), limit=megabytes * 1_000_000)
        lines = stderr.count("\n")
        right = (status, lines) in ((0, 0), (1, 1))
        what = f"{megabytes} MB, {arguments[-1]}"
        ends.note(what, kind_of(status, stderr), right=right, stderr=stderr)
        shutil.rmtree(folder / "data", ignore_errors=True)


def interrupt(made: Path, folder: Path, given: argparse.Namespace, ends: Ends) -> None:
    """Interrupt commands at random moments."""
    rng = random.Random(given.seed)
    for _ in range(given.interruptions):
        moment = rng.uniform(0, given.seconds)
        kill = rng.choice([os.kill, os.killpg])
        arguments = rng.choice([BUILD, DESCRIBE])
        if arguments is DESCRIBE:
            shutil.copytree(made, folder / "data")

        def act(process: int, moment: float = moment, kill: Callable[..., None] = kill) -> None:
            time.sleep(moment)
            with suppress(ProcessLookupError):
                kill(process, signal.SIGINT)

        status, stderr = ended(folder, (*arguments, f"labyrinths={given.labyrinths}"), act)
        lines = len(stderr.splitlines())
        right = (status, lines) in ((0, 0), (130, 1))
        kind = kind_of(status, stderr)
        reached = stderr.replace(f'"{RUN}", line 0', "")  # So Python names what it has only loaded.
        if status in (-signal.SIGINT, 1) and str(RUN.parent) not in reached:
            right, kind = True, "ended by Python before the first line of the program"
        whole = "group" if kill is os.killpg else "process"
        what = f"{whole} after {moment:.3f} s, {arguments[-1]}"
        ends.note(what, kind, right=right, stderr=stderr)
        shutil.rmtree(folder / "data", ignore_errors=True)


def main() -> None:
    """Parse the options, run, and report."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=50, help="under limits of memory")
    parser.add_argument("--megabytes", type=int, nargs="+", default=LIMITS)
    parser.add_argument("--interruptions", type=int, default=200)
    parser.add_argument("--labyrinths", type=int, default=150, help="in each split")
    parser.add_argument("--seconds", type=float, default=3.0, help="the latest interruption")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    memory, interruptions = Ends(), Ends()
    with tempfile.TemporaryDirectory(prefix="labyrinth-ends-") as temporary:
        folder, other = Path(temporary, "work"), Path(temporary, "other")
        folder.mkdir()
        other.mkdir()
        status, stderr = ended(other, (*BUILD, f"labyrinths={given.labyrinths}"))
        if status:
            raise SystemExit(stderr)
        run_out_of_memory(other / "data", folder, given, memory)
        interrupt(other / "data", folder, given, interruptions)
    for heading, ends in (("under limits of memory", memory), ("interrupted", interruptions)):
        print(f"{sum(ends.kinds.values())} commands {heading}, {len(ends.wrong)} wrong")
        for kind, count in sorted(ends.kinds.items()):
            print(f"{count:5} {kind}")
        for each in ends.wrong:
            print(each)
    sys.exit(bool(memory.wrong or interruptions.wrong))


if __name__ == "__main__":
    main()
