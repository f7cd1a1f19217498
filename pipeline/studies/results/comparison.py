"""Whether one method does better than another by more than chance, as figures and in Markdown.

Two of the figures of Agarwal et al. (2021), "Deep reinforcement learning at the edge of the
statistical precipice": the interquartile mean, and the probability of improvement. Intervals are
percentile bootstrap. Where methods are evaluated in the same labyrinths, labyrinths are resampled
for both together, and seeds for each method by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.intervals import CONFIDENCE
from labyrinth_core.evaluation.results import Results
from pipeline.machinery.markdown import plain, table
from pipeline.studies.results.figures import by_method, run_of, solved_in
from pipeline.studies.results.paper import name_of

SPLIT = "test"

ABOUT_PAIRS = f"""\
On {SPLIT}, the probability in percent that the method of a row does better in a labyrinth than that
of a column, a tie counting half:"""

ABOUT_SIZES = f"""\
Interquartile mean of SR on {SPLIT} over sizes and seeds, with an interval over seeds. It does not
say how SR would be in other labyrinths, so it ranks no method either.
"""

RESAMPLES = 10_000
"""More than elsewhere, as the bounds for many pairs lie far out."""


class Estimate(NamedTuple):
    """A figure and its interval."""

    value: float
    low: float
    high: float


def interquartile_mean(tasks: Sequence[NDArray[np.float64]]) -> Estimate:
    """Return the mean of the middle half of the scores of all runs, and its interval.

    A quarter of the scores, rounded down, is left out on either side. Runs are resampled in each
    task by itself (section 4.3 of the paper).

    Args:
        tasks: The score of each run in each task, shapes (runs,).
    """
    rng = np.random.default_rng(0)
    drawn = [each[rng.integers(len(each), size=(RESAMPLES, len(each)))] for each in tasks]
    (value,) = _middle(np.concatenate(tasks)[None]).tolist()
    return _estimate(value, _middle(np.concatenate(drawn, axis=1)), 1)


def _middle(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of the middle half of each row."""
    cut = scores.shape[1] // 4
    means: NDArray[np.float64] = np.sort(scores)[:, cut : scores.shape[1] - cut].mean(axis=1)
    return means


def improvement(mine: NDArray[np.float64], others: NDArray[np.float64], pairs: int = 1) -> Estimate:
    """Return the probability that one method scores higher than another; a tie counts half.

    The average over labyrinths of the share of pairs of runs in which it does (equation 2 of the
    paper, with labyrinths for tasks).

    Args:
        mine: The score of each run in each labyrinth, shape (runs, labyrinths).
        others: Those of the other method in the same labyrinths.
        pairs: How many pairs of methods are compared; the interval is wider so that all hold
            together (Bonferroni).
    """
    wins = (mine[:, None] > others) + 0.5 * (mine[:, None] == others)
    rng = np.random.default_rng(0)
    # How often each run of either method and each labyrinth is drawn, as a share.
    drawn = [
        rng.multinomial(size, np.full(size, 1 / size), RESAMPLES) / size for size in wins.shape
    ]
    means = np.einsum("ra,rb,rl,abl->r", *drawn, wins, optimize=True)
    return _estimate(float(wins.mean()), means, pairs)


def _estimate(value: float, resampled: NDArray[np.float64], pairs: int) -> Estimate:
    tail = (1 - CONFIDENCE) / 2 / pairs
    low, high = np.quantile(resampled, [tail, 1 - tail])
    return Estimate(value, float(low), float(high))


def pairs_of_methods(runs: Sequence[Results]) -> Iterator[str]:
    """Yield a table of all pairs of methods of one config and setup, and what follows from it.

    Nothing is yielded of a single method. `runs` are in the usual order.
    """
    groups = by_method(runs)
    solved = {name_of(run_of(group[0]).method): solved_in(group, SPLIT) for group in groups}
    pairs = len(solved) * (len(solved) - 1) // 2
    if not pairs:
        return
    found = {
        (mine, other): improvement(solved[mine], solved[other], pairs)
        for mine, other in permutations(solved, 2)
    }
    yield ABOUT_PAIRS
    rows = [[mine, *(_percent(found.get((mine, other))) for other in solved)] for mine in solved]
    yield table(["", *solved], rows, "l" + "r" * len(solved))
    yield _conclusion(found, pairs)


def _percent(each: Estimate | None) -> str:
    return "" if each is None else f"{100 * each.value:.0f}"


def _conclusion(found: dict[tuple[str, str], Estimate], pairs: int) -> str:
    better = [f"{mine} than {other}" for (mine, other), each in found.items() if each.low > 0.5]
    held = f"by 95% intervals that hold for all {pairs} pairs at once"
    if better:
        return f"Better by more than chance, {held}: {', '.join(better)}."
    return f"No method does better than another by more than chance, {held}. There is no ranking."


def across_sizes(results: Sequence[Results]) -> Iterator[str]:
    """Yield a table of interquartile means over sizes and seeds, if there are several sizes."""
    groups: dict[tuple[str, str, str], dict[str, list[Results]]] = {}
    for each in results:
        size, _, task = each.config.partition("-")
        run = run_of(each)
        groups.setdefault((task, run.setup, run.method), {}).setdefault(size, []).append(each)
    rows = []
    for (task, setup, method), by_size in groups.items():
        if len(by_size) > 1:
            tasks = [solved_in(runs, SPLIT).mean(axis=1) for runs in by_size.values()]
            mean, low, high = (100 * each for each in interquartile_mean(tasks))
            several = max(map(len, tasks)) > 1
            told = f"{mean:.1f}" + f" [{low:.1f}, {high:.1f}]" * several
            name = plain(" ".join(part for part in (setup, task) if part))
            runs = str(sum(map(len, tasks)))
            rows.append([name, name_of(method), ", ".join(by_size), runs, told])
    if rows:
        yield "## All sizes\n"
        yield ABOUT_SIZES
        yield table(["setup", "method", "sizes", "runs", "SR"], rows, "lllrr") + "\n"
