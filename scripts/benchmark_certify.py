"""Measure what `certify` costs beyond stepping by hand, with two processes, and in memory.

    pip install minigrid
    python scripts/benchmark_certify.py [--rounds N] [--quick] [CartPole-v1 MiniGrid-Empty-8x8-v0]
    python scripts/benchmark_certify.py --two [--rounds N] [MiniGrid-Empty-8x8-v0]
    python scripts/benchmark_certify.py --memory [CartPole-v1]

The first line compares CPU times of the same episodes, by hand and as `certify` looks at all seeds,
by turns: the median over rounds of the ratio, and its range. What `certify` does once, whatever the
number of seeds, is not part of it: a check of 8 seeds in new interpreters takes a few seconds.

`--two` certifies twice 2,000 seeds with one process and with two, by turns. On a busy machine the
time that passes says little, so it also prints what two free cores would take: the CPU seconds of
the process itself, which nothing shortens, and half of those of the processes that it starts.

`--memory` certifies twice 50,000 seeds and prints the largest resident set.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from measuring import cpu_seconds, machine, parser_of, ratio, take_turns

from labyrinth_core import certify
from labyrinth_core.benchmarks.certification import CHUNK, _look_at_chunk
from labyrinth_core.benchmarks.environment import Maker, state_function
from labyrinth_core.benchmarks.episodes import Protocol, action_sequences

FAR = 1_000_000
"""The first seed of test."""


def by_hand(maker: Maker, actions: tuple[tuple[Any, ...], ...], seeds: tuple[int, ...]) -> None:
    """Take the steps of `certify`, and nothing else."""
    env = maker.make()
    for seed in seeds:
        for sequence in actions:
            env.reset(seed=seed)
            for action in sequence:
                _, _, terminated, truncated, _ = env.step(action)
                if terminated or truncated:
                    break
    env.close()


def overhead(name: str, rounds: int) -> None:
    """Print the CPU time of `certify` for a chunk of seeds, as a multiple of that by hand."""
    maker, seeds = Maker.of(name), tuple(range(CHUNK))
    env = maker.make()
    actions, state = action_sequences(env, 4, 64, None), state_function(env, None)
    env.close()
    protocol = Protocol(maker, actions, state and state[1])
    ways: dict[str, Callable[[], object]] = {
        "by hand": partial(by_hand, maker, actions, seeds),
        "certify": partial(_look_at_chunk, protocol, frozenset(), seeds),
        "certify, with spread": partial(_look_at_chunk, protocol, frozenset(seeds), seeds),
    }
    calls = {way: partial(cpu_seconds, work) for way, work in ways.items()}
    times = take_turns(calls, rounds)
    for way, taken in times.items():
        middle = f"{name + ', ' + way:50}{1000 * median(taken) / CHUNK:8.2f} ms a seed"
        ratios = sorted(a / b for a, b in zip(taken, times["by hand"], strict=True))
        print(f"{middle}{median(ratios):8.3f} ({ratios[0]:.3f} - {ratios[-1]:.3f})", flush=True)


class Cost(NamedTuple):
    """What certifying costs, in seconds."""

    passed: float
    own: float
    """CPU seconds of this process."""
    others: float
    """CPU seconds of the processes that it started."""

    @property
    def on_two_cores(self) -> float:
        """The seconds that two free cores would take."""
        return self.own + self.others / 2


def cost(name: str, seeds: int, workers: int) -> Cost:
    """Return what certifying twice so many seeds costs."""
    from joblib.externals.loky import get_reusable_executor

    def spent() -> tuple[float, ...]:
        usages = [resource.getrusage(of) for of in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return time.perf_counter(), *(usage.ru_utime + usage.ru_stime for usage in usages)

    before = spent()
    certify(name, range(seeds), range(FAR, FAR + seeds), workers=workers, progress=False)
    passed = time.perf_counter() - before[0]
    get_reusable_executor().shutdown(wait=True)
    _, own, others = (b - a for a, b in zip(before, spent(), strict=True))
    return Cost(passed, own, others)


def two(name: str, seeds: int, rounds: int) -> None:
    """Print how many times as fast two processes are."""
    found = take_turns({each: partial(cost, name, seeds, each) for each in (1, 2)}, rounds)
    for workers, costs in found.items():
        for each in costs:
            print(
                f"{name}, {workers} processes: {each.passed:.1f} s passed, CPU seconds: "
                f"{each.own:.1f} own, {each.others:.1f} of others"
            )
    for label, value in (("that passed", "passed"), ("on two free cores", "on_two_cores")):
        times = [[getattr(each, value) for each in costs] for costs in found.values()]
        print(f"two processes, by the time {label}: {' times; '.join(ratio(*times))}", flush=True)


def memory(name: str) -> None:
    """Print the largest resident set of a new process that certifies."""
    code = "import sys; from benchmark_certify import cost; print(cost(sys.argv[1], 50_000, 1))"
    process = subprocess.Popen([sys.executable, "-c", code, name], cwd=Path(__file__).parent)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    print(f"{name}, 100,000 seeds: at most {usage.ru_maxrss / 1024:.0f} MiB; status {status}")


def main() -> None:
    """Measure and report."""
    parser = parser_of(__doc__, rounds=30)
    parser.add_argument("names", nargs="*", default=["CartPole-v1"], help="ids of Gymnasium")
    parser.add_argument("--two", action="store_true", help="one process and two")
    parser.add_argument("--memory", action="store_true", help="memory for 100,000 seeds")
    given = parser.parse_args()
    print(machine("numpy", "gymnasium", "minigrid"))
    for name in given.names:
        if given.two:
            two(name, 200 if given.quick else 2_000, given.rounds)
        elif given.memory:
            memory(name)
        else:
            overhead(name, 3 if given.quick else given.rounds)


if __name__ == "__main__":
    main()
