"""Which methods do better than which on test, as far as that is more than chance, in Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby, permutations
from operator import attrgetter

from pipeline.machinery.markdown import plain, table
from pipeline.studies.results.comparison import Estimate, improvement, interquartile_mean
from pipeline.studies.results.evaluations import Evaluation, solved_in
from pipeline.studies.results.paper import name_of

SPLIT = "test"

ABOUT_PAIRS = f"""\
On {SPLIT}, the probability in percent that the method of a row does better in a labyrinth than that
of a column, a tie counting half:"""

ABOUT_SIZES = f"""\
Interquartile mean of SR on {SPLIT} over sizes and seeds, with an interval over seeds. It does not
say how SR would be in other labyrinths, so it ranks no method either.
"""


def pairs_of_methods(runs: Sequence[Evaluation]) -> Iterator[str]:
    """Yield a table of all pairs of methods of one config and setup, and what follows from it.

    Nothing is yielded of a single method. `runs` are in the usual order.
    """
    by_method = groupby(runs, attrgetter("method"))
    solved = {name_of(method): solved_in(list(of), SPLIT) for method, of in by_method}
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


def across_sizes(evaluations: Sequence[Evaluation]) -> Iterator[str]:
    """Yield a table of interquartile means over sizes and seeds, if there are several sizes."""
    groups: dict[tuple[str, str, str], dict[str, list[Evaluation]]] = {}
    for each in evaluations:
        size, _, task = each.config.partition("-")
        groups.setdefault((task, each.setup, each.method), {}).setdefault(size, []).append(each)
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
