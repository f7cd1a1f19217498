"""Whether a seed means something: some seeds are played again, and what differs is named.

Each is played again in the same environment after other episodes, in a fresh environment, and in
two new interpreters with other values of PYTHONHASHSEED.
"""

from __future__ import annotations

import contextlib
import io
import os
import pickle
import random
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

from labyrinth_core.benchmarks.encoding import leaves
from labyrinth_core.benchmarks.environment import CertifyError, EnvironmentFailure, called
from labyrinth_core.benchmarks.episodes import Protocol, Stage, steps_of
from labyrinth_core.errors import one_line

CHECKED = 8
"""The number of seeds that are played again."""
EXPERIMENTS = 6
"""The number of episodes that an experiment compares, so that none agree by chance."""
HASH_SEEDS = ("1", "2", "3")
"""The values of PYTHONHASHSEED in new interpreters."""
CLOCKS = ("time", "time_ns", "monotonic", "monotonic_ns", "perf_counter", "perf_counter_ns")
"""The functions of the module `time` that tell the time."""

AGAIN = "in the same environment after other episodes"
FRESH = "in a fresh environment"
INTERPRETER = "in a new interpreter"
UNCHECKED = f"not checked {INTERPRETER}"
HASHES = "in a new interpreter with another PYTHONHASHSEED"

Leaves = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Trace:
    """Everything that is seen of a seed, as texts that can be compared and shown."""

    seed: int
    steps: tuple[tuple[int, int, Leaves], ...]
    """Probe, step, and the name and value of each part of what is seen."""
    state: Leaves = ()
    space: str = ""
    """The action space after the first reset."""

    @property
    def error(self) -> str:
        """What ended the episodes, if the environment failed."""
        name, value = self.steps[-1][2][0] if self.steps else ("", "")
        return value if name == "error" else ""


class Difference(NamedTuple):
    """The first difference between two traces of a seed."""

    measure: str
    """The first measure that it spoils: first, probes or state."""
    text: str


@dataclass(frozen=True)
class Check:
    """What was found when seeds were played again."""

    seeds: int
    """The number of seeds played again."""
    places: Sequence[str]
    """Where they were played again."""
    reasons: dict[str, str]
    """Measure that cannot stand -> the reason."""
    notes: tuple[str, ...]
    """What limits the measures that stand."""


def check_seeds(protocol: Protocol, seeds: Sequence[int]) -> Check:
    """Play seeds again, and return which measures cannot stand.

    Raises:
        CertifyError: The environment fails at all of the seeds.
    """
    stage = Stage(protocol)
    once = [trace(protocol, stage, seed) for seed in seeds]
    again = [trace(protocol, stage, seed) for seed in reversed(seeds)][::-1]
    stage.close()
    fresh = [trace_fresh(protocol, seed) for seed in seeds]
    usable = [each.seed for each in once if not each.error]
    if not usable:
        failed = f"seed {once[0].seed}: {once[0].error}"
        raise CertifyError(f"{protocol.maker.name} fails at each of {len(seeds)} seeds; {failed}")
    reasons: dict[str, str] = {}
    within = [Trace(each.seed, opening(each), each.state) for each in once]
    repeated = [Trace(each.seed, opening(each, of=0), each.state) for each in once]
    for where, first, others in (
        (AGAIN, repeated, within),
        (AGAIN, once, again),
        (FRESH, once, fresh),
    ):
        for measure, seed, text in _spoiled(first, others):
            cause = _cause(protocol, seed, where)
            reasons.setdefault(measure, f"{cause}: {where}, {text}")
    places = [AGAIN, FRESH]
    notes: tuple[str, ...] = ()
    if not reasons:
        notes = _new_interpreters(protocol, seeds, once, reasons)
        if not any(note.startswith(UNCHECKED) for note in notes):
            places.append("in new interpreters")
    spaces: dict[str, int] = {}
    for episode in once:
        if episode.space and " object at 0x" not in episode.space:  # Without a text of its own.
            spaces.setdefault(episode.space, episode.seed)
    if len(spaces) > 1:
        each = ", ".join(f"{space:.60} at seed {seed}" for space, seed in spaces.items())
        notes += (f"all seeds got the same actions, but the action space differs: {each}",)
    return Check(len(usable), places, reasons, notes)


def opening(trace: Trace, of: int | None = None) -> tuple[tuple[int, int, Leaves], ...]:
    """Return the first observations of a trace; if `of` is given, that of this probe for each."""
    first = {probe: seen for probe, step, seen in trace.steps if step == 0}
    return tuple((probe, 0, first[probe if of is None else of]) for probe in first)


def trace(protocol: Protocol, stage: Stage, seed: int) -> Trace:
    """Return what is seen of a seed in an environment."""
    steps: list[tuple[int, int, Leaves]] = []
    more: dict[str, Any] = {}
    names = ("observation", "reward", "terminated", "truncated")
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            for probe, (env, first, actions) in enumerate(protocol.walk(stage, seed)):
                steps.append((probe, 0, tuple(leaves(first, names[0]))))
                if not probe:
                    more["space"] = called(lambda env=env: repr(getattr(env, "action_space", None)))
                    if protocol.state is not None:
                        more["state"] = tuple(leaves(called(protocol.state, env), "state"))
                for step, seen in enumerate(steps_of(env, actions), 1):
                    parts = chain.from_iterable(map(leaves, seen, names))
                    steps.append((probe, step, tuple(parts)))
    except EnvironmentFailure as error:
        probe, step = steps[-1][:2] if steps else (0, -1)
        steps.append((probe, step + 1, (("error", str(error)),)))
        stage.close()
    return Trace(seed, tuple(steps), **more)


def trace_fresh(protocol: Protocol, seed: int) -> Trace:
    """Return what is seen of a seed in a new environment."""
    stage = Stage(protocol)
    try:
        return trace(protocol, stage, seed)
    finally:
        stage.close()


def _spoiled(first: Sequence[Trace], others: Sequence[Trace]) -> Iterator[tuple[str, int, str]]:
    """Yield each measure that differs between traces, with the seed and the first difference."""
    differing: dict[str, tuple[int, str]] = {}
    for one, other in zip(first, others, strict=True):
        for measure, text in differences(one, other):
            differing.setdefault(measure, (one.seed, f"seed {one.seed} differs at {text}"))
    for measure, (seed, text) in differing.items():
        yield measure, seed, text


def differences(one: Trace, other: Trace) -> Iterator[Difference]:
    """Yield the measures that differ between two traces of a seed, each with the difference."""
    if one.state != other.state:
        yield Difference("state", _difference(one.state, other.state))
    for a, b in zip(one.steps, other.steps, strict=False):
        if a != b:
            probe, step = min(a[:2], b[:2])
            at = f"step {step} of probe {probe + 1}, {_difference(a[2], b[2])}"
            if step == 0:
                yield Difference("first", at)
            yield Difference("probes", at)
            return
    if len(one.steps) != len(other.steps):
        yield Difference("probes", "the end of an episode")


def _difference(one: Leaves, other: Leaves) -> str:
    """Return the first part that differs, with its two values."""
    a, b = dict(one), dict(other)
    name = next((name for name in [*a, *b] if a.get(name) != b.get(name)), "")
    return f"{name}: {a.get(name, 'missing')}, then {b.get(name, 'missing')}"


# Why two episodes of a seed differ.


def _cause(protocol: Protocol, seed: int, where: str) -> str:
    """Return the likely reason why a seed gives another episode, found by experiments."""
    stage = Stage(protocol)

    def agree(prepare: Callable[[], Any], *, fresh: bool) -> bool:
        """Return whether episodes agree, each of which begins in the same circumstances."""
        traces = []
        for _ in range(EXPERIMENTS):
            with prepare():
                traces.append(
                    trace_fresh(protocol, seed) if fresh else trace(protocol, stage, seed)
                )
        return all(not list(differences(traces[0], other)) for other in traces[1:])

    fresh = where == FRESH
    try:
        trace(protocol, stage, seed)  # The first episode of an environment may be another.
        if not agree(contextlib.nullcontext, fresh=fresh):
            if agree(_seeded_globally, fresh=fresh):
                return "it draws from the global random state of `random` or `numpy.random`"
            if agree(_at_a_fixed_time, fresh=fresh):
                return "it reads a clock"
    finally:
        stage.close()
    if fresh:
        return "its levels are fixed when the environment is made, and not by the seed"
    if agree(contextlib.nullcontext, fresh=True):
        return "its levels depend on what was played before in the same environment"
    return "it ignores the seed, or not all of its randomness follows the seed"


@contextlib.contextmanager
def _seeded_globally() -> Iterator[None]:
    """Give the global random states fixed seeds for a while."""
    states = random.getstate(), np.random.get_state()  # noqa: NPY002  Those of others are meant.
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002
    try:
        yield
    finally:
        random.setstate(states[0])
        np.random.set_state(states[1])  # noqa: NPY002


@contextlib.contextmanager
def _at_a_fixed_time() -> Iterator[None]:
    """Let clocks begin at a fixed time for a while, and go on by one at each reading."""
    ticks = count(1_000_000_000)
    with contextlib.ExitStack() as stack:
        for name in CLOCKS:
            stack.enter_context(mock.patch(f"time.{name}", ticks.__next__))
        yield


# New interpreters.


def _new_interpreters(
    protocol: Protocol, seeds: Sequence[int], once: list[Trace], reasons: dict[str, str]
) -> tuple[str, ...]:
    """Play seeds in new interpreters, add what cannot stand to `reasons`, and return notes."""
    fixed = os.environ.get("PYTHONHASHSEED", "random")
    first = HASH_SEEDS[0] if fixed == "random" else fixed
    try:
        values = (first, *(each for each in HASH_SEEDS if each != first))
        same, *others = _in_new_interpreters(protocol, seeds, values)
        spoiled = [each for other in (same, *others) for each in _spoiled(once, other)]
        if not spoiled:
            return ()
        (repeated,) = _in_new_interpreters(protocol, seeds, values[:1])
    except CertifyError as error:
        return (f"{UNCHECKED}: {error}",)
    by_hash = same == repeated and any(same != other for other in others)
    where, cause = INTERPRETER, "it depends on the process"
    if by_hash:
        where, cause = HASHES, "it depends on PYTHONHASHSEED"
        if fixed != "random" and not [*_spoiled(once, same)]:
            return (f"only with PYTHONHASHSEED={fixed}: {where}, {spoiled[0][2]}",)
    for measure, _, text in spoiled:
        reasons.setdefault(measure, f"{cause}: {where}, {text}")
    return ()


def _in_new_interpreters(
    protocol: Protocol, seeds: Sequence[int], hash_seeds: Sequence[str]
) -> list[list[Trace]]:
    """Return the traces of seeds in a new interpreter for each value of PYTHONHASHSEED.

    Raises:
        CertifyError: The environment cannot be sent there, or not made there.
    """
    import cloudpickle

    with TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        request = Path(name) / "request"
        try:
            request.write_bytes(cloudpickle.dumps((protocol, seeds)))
        except Exception as error:  # A function of others may hold anything.
            reason = f"{protocol.maker.name} cannot be pickled"
            raise CertifyError(f"{reason}: {type(error).__name__}: {one_line(error)}") from error
        running = []
        for index, value in enumerate(hash_seeds):
            answer = Path(name) / f"answer{index}"
            code = "import sys; sys.path[:] = sys.argv[3:]; "
            code += "from labyrinth_core.benchmarks.repeats import answer; answer(*sys.argv[1:3])"
            arguments = [sys.executable, "-W", "ignore", "-c", code, str(request), str(answer)]
            process = subprocess.Popen(
                [*arguments, *sys.path],
                env=os.environ | {"PYTHONHASHSEED": value},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
            stack.callback(process.kill)
            running.append((process, answer))
        answers = []
        for process, answer in running:
            _, errors = process.communicate()
            if process.returncode or not answer.is_file():
                last = (errors.strip().splitlines() or [f"status {process.returncode}"])[-1]
                raise CertifyError(f"it fails there: {last:.300}")
            answers.append(pickle.loads(answer.read_bytes()))
        return answers


def answer(request: str, path: str) -> None:
    """Write the traces of seeds to a file; this is what a new interpreter does."""
    protocol, seeds = pickle.loads(Path(request).read_bytes())
    stage = Stage(protocol)
    traces = [trace(protocol, stage, seed) for seed in seeds]
    Path(path).write_bytes(pickle.dumps(traces))
