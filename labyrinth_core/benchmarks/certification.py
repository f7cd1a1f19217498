"""`certify`: look at an environment's seeds from outside, and count the levels of test in train."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.benchmarks.certificate import Certificate
from labyrinth_core.benchmarks.environment import (
    CertifyError,
    Maker,
    Seeds,
    StateOf,
    close,
    evenly,
    seeds_of,
    state_function,
    text_of,
    versions_of,
)
from labyrinth_core.benchmarks.episodes import (
    Draw,
    Protocol,
    Seen,
    Stage,
    action_sequences,
    look,
)
from labyrinth_core.benchmarks.levels import MOST_SEEDS, Ranges
from labyrinth_core.benchmarks.memory import Policy, measure_memory
from labyrinth_core.benchmarks.minari_dataset import PREFIX, certify_minari
from labyrinth_core.benchmarks.records import SUFFIXES, Split, read_records
from labyrinth_core.benchmarks.repeats import CHECKED, check_seeds
from labyrinth_core.errors import printable

CHUNK = 100
"""The number of seeds that are looked at in one environment."""
MEASURES = ("first", "probes", "state")


def certify(
    environment: str | Path | Callable[[], Any],
    train: Seeds | float | str | None = None,
    test: Seeds | str | None = None,
    *,
    probes: int = 4,
    steps: int = 64,
    actions: Draw | None = None,
    state: StateOf | None = None,
    fresh: bool = False,
    policy: Policy | None = None,
    demonstrations: Mapping[int, Sequence[Any]] | None = None,
    solved_above: float = 0.0,
    workers: int = 1,
    progress: bool = True,
) -> Certificate:
    """Count how many levels an environment's seeds give, and how many of test are in train.

    Some seeds are first played again, in the same environment, in a fresh one and in new
    interpreters; a measure that does not repeat is refused with the reason.

    Args:
        environment: An id of Gymnasium, such as `module:Name-v0`; a function without arguments
            that makes an environment; a file of records (`.jsonl`, `.parquet`); or `minari:ID`.
        train: The seeds of train: a range, a list or a text such as `0:1000`. None for records.
            For Minari, the share of the episodes that are train, the first ones; 0.8 if None.
        test: The seeds of test, as for train. None for records. For Minari, the id of another
            dataset to compare with, instead of a share.
        probes: The number of random action sequences.
        steps: The number of steps of each.
        actions: Draws an action from a generator, if the action space cannot be sampled.
        state: Returns everything that determines how the environment goes on, from the environment
            after a reset; known for MiniGrid and Labyrinth.
        fresh: Whether to make the environment anew for each episode.
        policy: Returns an action for an observation, to measure memory.
        demonstrations: Seed of train -> the actions that memory replays, instead of the policy's.
        solved_above: The return above which an episode counts as solved.
        workers: The number of processes.
        progress: Whether to show a progress bar, in a terminal.

    Raises:
        CertifyError: An argument has a value that is not allowed, a file is not one of records, or
            the environment cannot be made or fails at all seeds.
    """
    for name, value, least in (("probes", probes, 0), ("steps", steps, 1), ("workers", workers, 1)):
        if type(value) is not int or value < least:
            raise CertifyError(f"{name}={value}: give a whole number, {least} or more")
    if isinstance(environment, str) and environment.startswith(PREFIX):
        return certify_minari(environment, train, test)
    if isinstance(environment, Path) or str(environment).endswith(SUFFIXES):
        return _certify_records(Path(str(environment)).expanduser(), train, test)
    maker = Maker.of(environment)
    seeds = {"train": seeds_of(train, "train"), "test": seeds_of(test, "test")}
    env = maker.make()
    try:
        versions, named_state = versions_of(env), state_function(env, state)
        sequences = action_sequences(env, probes, steps, actions)
        says_random = getattr(getattr(env, "spec", None), "nondeterministic", False)
        space = getattr(env, "action_space", None)
    finally:
        close(env)
    arguments: dict[str, Any] = {"environment": maker.name}
    arguments |= {split: text_of(of_split) for split, of_split in seeds.items()}
    arguments |= {"probes": probes, "steps": steps} | ({"fresh": True} if fresh else {})
    protocol = Protocol(maker, sequences or (), named_state and named_state[1], fresh)
    job = _Job(protocol, workers, progress)
    tried = [seed for of_split in seeds.values() for seed in evenly(of_split, CHECKED // 2)]
    check = check_seeds(protocol, list(dict.fromkeys(tried)))
    reasons = dict(check.reasons)
    if sequences is None:
        reasons["probes"] = "its action space cannot be sampled: give actions="
    elif not probes:
        reasons["probes"] = "probes=0"
    elif says_random:
        reasons.setdefault("probes", "its specification says that it is nondeterministic")
    notes, ranges = [*check.notes], Ranges()
    splits = {split: Split(of_split, {}) for split, of_split in seeds.items()}
    if not set(MEASURES[: 2 + (named_state is not None)]) <= set(reasons):
        if "probes" in reasons:
            job = replace(job, protocol=replace(protocol, actions=()))
        splits = _look_at(job, seeds, reasons, ranges)
    both = len({*splits["train"].seeds} & {*splits["test"].seeds})
    if both:
        notes.append(f"{both:,} seeds are in train and in test")
    memory = None
    if policy is not None or demonstrations is not None:
        if actions is None and space is None:
            raise CertifyError("memory: the environment has no action space: give actions=")
        memory = measure_memory(
            protocol,
            splits["train"].seeds,
            splits["test"].seeds,
            policy,
            demonstrations,
            actions or partial(_sample, space),
            solved_above,
            job.each,
        )
    return Certificate(
        environment=maker.name,
        arguments=arguments,
        versions=versions,
        train=splits["train"],
        test=splits["test"],
        reasons=reasons,
        checked=f"{check.seeds} were played again: {', '.join(check.places)}"
        + ("" if check.reasons or check.notes else "; nothing differs"),
        notes=tuple(notes),
        state_function=named_state[0] if named_state else "",
        spread=None if "first" in reasons else ranges.spread(),
        memory=memory,
    )


def _sample(space: Any, rng: np.random.Generator) -> Any:
    space.seed(int(rng.integers(1 << 31)))
    return space.sample()


def _certify_records(path: Path, train: object, test: object) -> Certificate:
    if train is not None or test is not None:
        raise CertifyError(f"{path}: the records name their splits: leave out train and test")
    records = read_records(path)
    versions = records.head.get("versions")
    versions = versions if isinstance(versions, dict) else {}
    checked = f"{records.again:,} were recorded more than once"
    return Certificate(
        environment=printable(str(records.head.get("environment", path.name)))[:200],
        arguments={"environment": path.name},
        versions={printable(str(k)): printable(str(v)) for k, v in versions.items()},
        train=records.splits["train"],
        test=records.splits["test"],
        reasons=records.reasons,
        checked=checked if records.again else "",
        notes=() if records.again else ("no seed was recorded twice, so none was checked",),
    )


# Looking at all seeds.


@dataclass(frozen=True)
class _Job:
    """How the seeds are looked at."""

    protocol: Protocol
    workers: int
    progress: bool

    def each(
        self, function: Callable[[int], Any], seeds: Sequence[int], label: str
    ) -> Iterator[Any]:
        """Yield a function of each seed, in order, under a progress bar."""
        for result in self.map(partial(_every, function), seeds, label):
            yield from result

    def map(
        self, function: Callable[[tuple[int, ...]], Any], seeds: Sequence[int], label: str
    ) -> Iterator[Any]:
        """Yield a function of each chunk of seeds, in order, under a progress bar."""
        from rich.console import Console
        from rich.progress import Progress

        chunks = [tuple(seeds[at : at + CHUNK]) for at in range(0, len(seeds), CHUNK)]
        console = Console(stderr=True)
        hidden = not (self.progress and console.is_terminal)
        with Progress(console=console, transient=True, disable=hidden) as bars:
            bar = bars.add_task(label, total=len(seeds))
            for chunk, results in zip(chunks, self._results(function, chunks), strict=True):
                yield results
                bars.advance(bar, len(chunk))

    def _results(
        self, function: Callable[[tuple[int, ...]], Any], chunks: list[tuple[int, ...]]
    ) -> Iterator[Any]:
        workers = min(self.workers, len(chunks))
        if workers <= 1:
            yield from map(function, chunks)
            return
        from joblib import Parallel, delayed

        parallel = Parallel(n_jobs=workers, return_as="generator", batch_size=1)
        try:
            yield from parallel(delayed(function)(chunk) for chunk in chunks)
        except BrokenExecutor as error:
            text = "a process was lost, perhaps for lack of memory: try fewer workers"
            raise CertifyError(f"workers={self.workers}: {text}") from error


def _every(function: Callable[[int], Any], seeds: tuple[int, ...]) -> list[Any]:
    with contextlib.redirect_stdout(io.StringIO()):
        return [function(seed) for seed in seeds]


@dataclass(frozen=True)
class _Chunk:
    """What was seen of some seeds in one environment."""

    seen: list[Seen]
    again: tuple[Seen, Seen] | None
    """The first seed that did not fail, before and after the others."""
    first: list[NDArray[np.float64]]
    low: NDArray[np.float64] | None
    high: NDArray[np.float64] | None


def _look_at(
    job: _Job, seeds: Mapping[str, tuple[int, ...]], reasons: dict[str, str], ranges: Ranges
) -> dict[str, Split]:
    """Look at all seeds, gather ranges, and add to `reasons` what turns out not to repeat.

    Raises:
        CertifyError: The environment fails at all seeds of a split.
    """
    every = [*dict.fromkeys(seed for of_split in seeds.values() for seed in of_split)]
    compared = frozenset(evenly(every, MOST_SEEDS))
    function = partial(_look_at_chunk, job.protocol, compared)
    numbers = np.zeros((len(MEASURES), len(every)), np.uint64)
    errors: dict[int, str] = {}
    at = 0
    for chunk in job.map(function, every, "seeds"):
        for seen in chunk.seen:
            numbers[:, at] = seen.first, seen.probes, seen.state
            at += 1
            if seen.error:
                errors[seen.seed] = seen.error
            elif not seen.steady:
                text = f"seed {seen.seed} gave another first observation when reset again"
                reasons.setdefault("first", text)
                reasons.setdefault("probes", text)
        for measure in MEASURES if chunk.again else ():
            one, other = (getattr(episode, measure) for episode in chunk.again)
            if one != other or chunk.again[1].error:
                text = f"seed {chunk.again[0].seed} gave something else after other episodes"
                reasons.setdefault(measure, text)
        ranges.join(chunk.first, chunk.low, chunk.high)
    if job.protocol.state is not None and "state" not in reasons:
        finer = next((at for at in (1, 0) if MEASURES[at] not in reasons), None)
        if finer is not None and (text := _left_out(every, numbers[2], numbers[finer], errors)):
            reasons["state"] = text
    index_of = {seed: at for at, seed in enumerate(every)}
    stand = [m for m in MEASURES if m not in reasons and (m != "state" or job.protocol.state)]
    splits = {}
    for split, of_split in seeds.items():
        usable = tuple(seed for seed in of_split if seed not in errors)
        if not usable:
            seed = of_split[0]
            name = job.protocol.maker.name
            raise CertifyError(f"{name} fails at all {split} seeds; seed {seed}: {errors[seed]}")
        columns = numbers[:, [index_of[seed] for seed in usable]]
        digests = dict(zip(MEASURES, columns, strict=True))
        failed = tuple((seed, errors[seed]) for seed in of_split if seed in errors)
        splits[split] = Split(usable, {measure: digests[measure] for measure in stand}, failed)
    return splits


def _left_out(
    seeds: Sequence[int],
    states: NDArray[np.uint64],
    seen: NDArray[np.uint64],
    errors: Mapping[int, str],
) -> str:
    """Return which seeds have equal states and look different; empty if there are none."""
    before: dict[int, tuple[int, int]] = {}
    for seed, state, look_of_it in zip(seeds, states.tolist(), seen.tolist(), strict=True):
        if seed not in errors:
            other, look_of_other = before.setdefault(state, (seed, look_of_it))
            if look_of_other != look_of_it:
                return f"seeds {other} and {seed} have equal states and other episodes"
    return ""


def _look_at_chunk(protocol: Protocol, compared: frozenset[int], seeds: tuple[int, ...]) -> _Chunk:
    stage, ranges = Stage(protocol), Ranges()
    again = None
    with contextlib.redirect_stdout(io.StringIO()):
        seen = [*look(protocol, stage, seeds, ranges, compared)]
        fine = next((episode for episode in seen if not episode.error), None)
        if fine is not None and len(seeds) > 1:
            again = fine, next(look(protocol, stage, [fine.seed]))
    stage.close()
    return _Chunk(seen, again, ranges.first, ranges.low, ranges.high)
