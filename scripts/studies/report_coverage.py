"""How often an interval contains the true mean, by simulation: a table of results.md.

The logit of a success has a normal distribution, with a standard deviation of 1 over labyrinths and
another over the seeds of a method. One seed is a policy, so its interval has to contain the mean
over labyrinths of that policy alone. `report_pages.py` writes the table.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.scores import interval
from pipeline.machinery import table

SHARES = (0.02, 0.1, 0.5, 0.9, 0.98)
"""The true success rates."""

OTHER = 0.5
"""The true success rate on the labyrinths of the split that is subtracted."""

CASES = (
    *((1, 12, 0.0), (1, 32, 0.0), (1, 100, 0.0), (2, 100, 0.7)),
    *((3, 32, 0.7), (3, 100, 0.7), (5, 100, 0.7), (10, 100, 0.7)),
    *((3, 100, 1.4), (3, 1_000, 1.4)),
)
"""Seeds, labyrinths, and the standard deviation over seeds."""

DETOURS = 0.3
"""The share of the solutions whose SPL is below 1: it lies between 0.5 and 1."""

REPETITIONS = 500

Floats = NDArray[np.float64]


def coverage() -> str:
    """Return a table of the lowest coverage over all success rates, in percent."""
    rows = []
    for seeds, labyrinths, of_seeds in CASES:
        cells = (f"{100 * share:.1f}" for share in covered(seeds, labyrinths, of_seeds).min(axis=0))
        spread = f"{of_seeds}" if seeds > 1 else ""
        rows.append([f"{seeds}", f"{labyrinths:,}", spread, *cells])
    return table(["seeds", "labyrinths", "spread of seeds", "SR", "SPL", "gap"], rows, "r" * 6)


def covered(seeds: int, labyrinths: int, of_seeds: float) -> Floats:
    """Return how often the intervals of SR, SPL and gap contain the truth, shape (SHARES, 3)."""
    rng = np.random.default_rng(0)
    places = [_place(share, of_seeds) for share in (*SHARES, OTHER)]
    hits = np.zeros((len(SHARES), 3))
    for number, share in enumerate(SHARES):
        truths = share, share * (1 - DETOURS / 4), share - OTHER
        for _ in range(REPETITIONS):
            shifts = of_seeds * rng.standard_normal((seeds, 1))
            solved, others = (
                _solved(rng, place + shifts, labyrinths) for place in (places[number], places[-1])
            )
            detours = rng.random(solved.shape) < DETOURS
            weighted = solved * np.where(detours, rng.uniform(0.5, 1, solved.shape), 1)
            found = interval(solved), interval(weighted), interval(solved, others)
            for figure, ((low, high), truth) in enumerate(zip(found, truths, strict=True)):
                hits[number, figure] += low <= truth <= high
    return hits / REPETITIONS


def _solved(rng: np.random.Generator, logits: Floats, labyrinths: int) -> Floats:
    """Return 1 for each solved labyrinth, else 0, shape (seeds, labyrinths).

    Args:
        rng: The source of randomness.
        logits: The mean logit of each seed, shape (seeds, 1).
        labyrinths: The number of labyrinths.
    """
    all_logits = logits + rng.standard_normal(labyrinths)
    return (rng.random(all_logits.shape) * (1 + np.exp(-all_logits)) < 1).astype(np.float64)


def _place(share: float, of_seeds: float) -> float:
    """Return the mean of the logits at which a share of all is solved."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(64)
    logits = np.linspace(-12, 12, 2_401)
    spread = np.hypot(1, of_seeds) * nodes
    shares = (1 / (1 + np.exp(-logits[:, None] - spread))) @ (weights / weights.sum())
    return float(np.interp(share, shares, logits))
