"""Fuzz the parsers with damaged texts: each must give a labyrinth or a LabyrinthSyntaxError.

    python scripts/fuzz_language.py --inputs 1000000 --seed 0 --workers 2

The exit status is 1 if anything else happens; the texts that cause it are printed.
"""

from __future__ import annotations

import argparse
import pickle
import resource
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from labyrinth_core.language.edge_list import parse_edges
from labyrinth_core.language.text import LabyrinthSyntaxError, dump, parse
from labyrinth_core.world.dynamics import state_at, state_count
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure, Task
from labyrinth_core.world.sampling import sample_structures
from labyrinth_core.world.tasks import place

CHUNK = 5_000
"""The number of inputs that are made from one child of the seed and checked by one worker."""
CHARACTERS = [
    *' |+-"SEKDIsex:,;()[]019\n\r\t\0\x1b\ufeff\u2028\xa0\xe9\U0001f600\ud800',
    '"""',
    "\r\n",
]
PHRASES = [
    "labyrinth:",
    "end",
    "icy_floor: True",
    "key_and_lock: true",
    "occlusion:True",
    "agent: (1, 0)",
    "agent:(0,1) with open door",
    '"""',
    "",
]


@dataclass
class Summary:
    """The outcomes of a number of inputs."""

    accepted: int = 0
    rejected: int = 0
    slowest: float = 0.0
    """The time of the slowest input in seconds."""
    peak_memory: int = 0
    """The peak memory of a worker in KiB."""
    failures: list[str] = field(default_factory=list)


def random_labyrinth(rng: np.random.Generator) -> Labyrinth:
    """Return a labyrinth of a random size and task, not always with a connected structure.

    In every fourth one the agent begins elsewhere than on the start, if it can.
    """
    height, width = (int(side) for side in rng.integers(2, 8, size=2))
    open_walls = float(rng.choice([0.0, 0.1, 0.7]))
    structure = next(sample_structures(height, width, rng, open_walls=open_walls))
    start, goal = (int(cell) for cell in rng.choice(structure.cells, size=2, replace=False))
    if rng.random() < 0.2:
        up = structure.up & int.from_bytes(rng.bytes(8), "little")
        structure = Structure(height, width, up, structure.right)
    try:
        labyrinth = place(structure, start, goal, list(Task)[rng.integers(4)], rng)
    except LabyrinthError:
        return random_labyrinth(rng)
    if rng.random() < 0.25:
        agent = state_at(labyrinth, int(rng.integers(state_count(labyrinth))))
        with suppress(LabyrinthError):
            return replace(labyrinth, agent=agent)
    return labyrinth


def edge_list(labyrinth: Labyrinth) -> str:
    """Return a labyrinth as an edge list, the older format."""
    tiles = [labyrinth.start, labyrinth.goal]
    if labyrinth.key is not None and labyrinth.door is not None:
        tiles += [labyrinth.key, labyrinth.door]
    parts = [str(list(labyrinth.structure.passages()))]
    parts += [str(labyrinth.position(cell)) for cell in tiles]
    if labyrinth.ice:
        parts.append(str([labyrinth.position(cell) for cell in sorted(labyrinth.ice)]))
    return ";".join(parts)


def damage(text: str, rng: np.random.Generator) -> str:
    """Return a text after one random edit."""
    edit = int(rng.integers(9))
    place = int(rng.integers(len(text) + 1))
    character: str = CHARACTERS[rng.integers(len(CHARACTERS))]
    if edit == 0:
        return text[:place] + character + text[place:]
    if edit == 1:
        return text[:place] + character + text[place + 1 :]
    if edit == 2:
        return text[:place] + text[place + 1 :]
    if edit == 3:
        return text.replace("SEKDI"[rng.integers(5)], " ")
    if edit == 4:
        return text.replace("False", "True", 1)
    if edit == 5:
        other = int(rng.integers(len(text) + 1))
        return text[:place] + text[min(place, other) : max(place, other)] + text[place:]
    lines = text.split("\n")
    line = int(rng.integers(len(lines)))
    if edit == 6:
        lines[line] = PHRASES[rng.integers(len(PHRASES))]
    elif edit == 7:
        lines.insert(line, lines[rng.integers(len(lines))])
    else:
        lines[line] += f' """{character}""" '
    return "\n".join(lines)


def inputs(count: int, rng: np.random.Generator) -> Iterator[str]:
    """Yield texts: labyrinths in both formats with zero to five edits, and some random bytes."""
    for _ in range(count):
        kind = rng.random()
        if kind < 0.05:
            yield rng.bytes(int(rng.integers(200))).decode("latin-1")
            continue
        labyrinth = random_labyrinth(rng)
        text = dump(labyrinth) if kind < 0.85 else edge_list(labyrinth)
        for _ in range(int(rng.integers(6))):
            text = damage(text, rng)
        yield text


def check(text: str) -> int:
    """Return the number of parsers, of the two, that accept a text.

    Raises:
        AssertionError: A labyrinth or an error is wrong.
    """
    accepted = 0
    for parser in (parse, parse_edges):
        try:
            labyrinth = parser(text)
        except LabyrinthSyntaxError as error:
            _check_error(text, error)
        else:
            accepted += 1
            canonical = dump(labyrinth)
            again = parse(canonical)
            assert again == labyrinth, "the dumped text gives another labyrinth"
            assert dump(again) == canonical, "the dumped text is not canonical"
    return accepted


def _check_error(text: str, error: LabyrinthSyntaxError) -> None:
    lines = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    assert error.source_line == lines[error.line - 1], "the error shows another line"
    assert 1 <= error.column <= len(error.source_line) + 1, "the column is outside the line"
    message = str(error)
    assert message.count("\n") == 2, "the message has not three lines"
    assert message.replace("\n", "").isprintable(), "the message has control characters"
    assert len(message) < 500, "the message is long"
    assert str(pickle.loads(pickle.dumps(error))) == message, "the error does not survive pickling"


def fuzz(count: int, seed: np.random.SeedSequence) -> Summary:
    """Return the outcomes of `count` inputs."""
    summary = Summary()
    for text in inputs(count, np.random.default_rng(seed)):
        begin = time.perf_counter()
        try:
            accepted = check(text)
        except Exception as error:
            summary.failures.append(f"{type(error).__name__}: {error}\n  {text!r}")
        else:
            summary.accepted += bool(accepted)
            summary.rejected += not accepted
        summary.slowest = max(summary.slowest, time.perf_counter() - begin)
    summary.peak_memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return summary


def main() -> int:
    """Return the exit status: 1 if an input had an outcome that is not allowed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--inputs", type=int, default=100_000, help="number of texts")
    parser.add_argument("--seed", type=int, default=0, help="the same seed, the same texts")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    options = parser.parse_args()
    counts = [CHUNK] * (options.inputs // CHUNK)
    if options.inputs % CHUNK:
        counts.append(options.inputs % CHUNK)
    seeds = np.random.SeedSequence(options.seed).spawn(len(counts))
    begin = time.perf_counter()
    with ProcessPoolExecutor(options.workers) as pool:
        parts = list(pool.map(fuzz, counts, seeds))
    total = Summary(
        sum(part.accepted for part in parts),
        sum(part.rejected for part in parts),
        max(part.slowest for part in parts),
        max(part.peak_memory for part in parts),
        [failure for part in parts for failure in part.failures],
    )
    for failure in total.failures[:20]:
        print(failure.encode(errors="backslashreplace").decode(), file=sys.stderr)
    print(
        f"{options.inputs:,} inputs: {total.accepted:,} accepted, {total.rejected:,} rejected, "
        f"{len(total.failures):,} failures; {time.perf_counter() - begin:.0f} s, the slowest "
        f"input {total.slowest * 1e3:.1f} ms, peak memory of a worker "
        f"{total.peak_memory / 1024:.0f} MiB"
    )
    return 1 if total.failures else 0


if __name__ == "__main__":
    sys.exit(main())
