"""`compare` two policies on fresh labyrinths until one is shown to be better.

from labyrinth_core import Dataset, compare

print(compare(policy, other, Dataset("data/labyrinth", "5x5")))

Only labyrinths that exactly one of the two solves tell them apart, as in McNemar's test. If both
policies are equally good, each is equally likely to be the one that solves such a labyrinth. The
evidence against that is a likelihood ratio: the probability of the observed wins if the first
policy wins an unknown share of them, with Jeffreys' prior, over their probability if the share is a
half. It is a test martingale (Ville 1939), so looking at it after every labyrinth, and stopping
when it is large, does not raise the probability of an error: see Ramdas, Grunwald, Vovk and Shafer
2023, "Game-theoretic statistics and safe anytime-valid inference", and Waudby-Smith and Ramdas
2024, "Estimating means of bounded random variables by betting".
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from math import exp, lgamma, log, pi
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core import typed
from labyrinth_core.checks import whole
from labyrinth_core.data import Dataset, Drawing
from labyrinth_core.evaluation import Evaluation
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.results import COLUMNS
from labyrinth_core.world import RULES

TOGETHER = 64
"""The number of labyrinths that are drawn at a time."""

ADVICE = (
    "give it a second argument rng to draw from, or reset(count) and act(observations) if it "
    "remembers"
)

PURPOSE = 3
"""The random key of fresh labyrinths, which no part of a dataset uses."""


def log_evidence(
    wins: int, losses: int, share: float | NDArray[np.float64] = 0.5
) -> NDArray[np.float64]:
    """Return the logarithm of the evidence against a share of wins.

    Args:
        wins: The labyrinths that the first policy alone solves.
        losses: The labyrinths that the other policy alone solves.
        share: The share or shares, above 0 and below 1, shape (...).

    Returns:
        An array of the shape of `share`.
    """
    # The ratio of two values of the beta function, the second of which is pi.
    seen = lgamma(wins + 0.5) + lgamma(losses + 0.5) - lgamma(wins + losses + 1) - log(pi)
    return np.asarray(seen - wins * np.log(share) - losses * np.log1p(-np.asarray(share)))


@dataclass(frozen=True, repr=False)
class Comparison:
    """Two policies in the same labyrinths."""

    labyrinths: int
    """The number of labyrinths in which both were judged."""
    both: int
    """How many of them both solve."""
    wins: int
    """How many of them the first policy alone solves."""
    losses: int
    """How many of them the other policy alone solves."""
    steps: int
    """The number of steps within which a labyrinth has to be solved."""
    error: float
    """The largest probability of declaring one of two equally good policies better."""

    @property
    def evidence(self) -> float:
        """The evidence against both being equally good; 1 / `error` decides."""
        return exp(min(float(log_evidence(self.wins, self.losses)), 700))

    @property
    def better(self) -> str | None:
        """The better policy, "first" or "other"; None if that is not decided."""
        if log_evidence(self.wins, self.losses) < -log(self.error):
            return None
        return "first" if self.wins > self.losses else "other"

    @property
    def difference(self) -> float:
        """The first policy's success rate minus the other's; stopping early exaggerates it."""
        return (self.wins - self.losses) / self.labyrinths

    @property
    def interval(self) -> tuple[float, float]:
        """Bounds of the share of wins among the labyrinths that one policy alone solves.

        With probability 1 - `error`, the share lies within them at all times together. They are 0
        and 1 as long as no labyrinth tells the policies apart.
        """
        # The share expected after these labyrinths is always within the bounds.
        expected = (self.wins + 0.5) / (self.wins + self.losses + 1)
        shares = np.sort(np.append(np.linspace(0.001, 0.999, 999), expected))
        against = log_evidence(self.wins, self.losses, shares)
        low, high = shares[against < -log(self.error)][[0, -1]].tolist()
        return (low if low > shares[0] else 0.0), (high if high < shares[-1] else 1.0)

    def __repr__(self) -> str:
        """Return the verdict and the counts that it rests on."""
        first, other = ((self.both + alone) / self.labyrinths for alone in (self.wins, self.losses))
        verdict = {
            "first": "the first policy is better",
            "other": "the other policy is better",
            None: "not decided",
        }[self.better]
        return fill(
            f"{verdict}, after {self.labyrinths:,} labyrinths: within {self.steps:,} steps the "
            f"first solves {first:.1%}, the other {other:.1%}; {self.wins:,} are solved by the "
            f"first alone, {self.losses:,} by the other alone (evidence {self.evidence:.3g} of the "
            f"{1 / self.error:.3g} that decide)",
            COLUMNS,
        )


def compare(
    policy: Any,
    other: Any,
    source: str | Path | Dataset,
    config: str | None = None,
    *,
    observation: str | tuple[str | None, str | None] | None = None,
    image_size: int | tuple[int | None, int | None] | None = None,
    within: str = "cells",
    most: int = 10_000,
    error: float = 0.05,
    seed: int = 0,
    revision: str | None = None,
) -> Comparison:
    """Compare two policies on fresh labyrinths of the distribution of `test`, until one is better.

    The labyrinths are drawn `TOGETHER` at a time, on structures that no dataset trains on. A
    stochastic policy plays one episode in each. The probability of declaring one of two equally
    good policies better is at most `error`, however often the evidence is checked.

    Args:
        policy: The first policy, as `evaluate` takes it.
        other: The other policy.
        source: A `Dataset`, which sets size, task and sampler; or its folder, or its id on the
            Hub. Only its manifest is read.
        config: Name of the dataset's config, such as `5x5`; not with a `Dataset`.
        observation: As for `evaluate`, for both policies or as a pair.
        image_size: As for `evaluate`, for both policies or as a pair.
        within: The number of steps allowed: "cells" for as many as the labyrinth has cells,
            "limit" for the step limit of the benchmark, within which random steps solve most.
        most: The number of labyrinths after which to stop undecided.
        error: The largest probability of an error, above 0 and below 1.
        seed: Seed of the labyrinths and of stochastic policies.
        revision: Branch, tag or commit on the Hub; not for folders or with a `Dataset`.

    Raises:
        ValueError: An argument has a value that is not allowed.
        PolicyError: An argument is not a policy, or a policy raises an error, answers with anything
            but actions or the same observations differently, or cannot be shown these labyrinths.
        DatasetError: The dataset does not exist.
        LabyrinthError: Too few structures can hold the dataset's task; see `sample_test`.
    """
    seed, most = whole("seed", seed, 0, typed.MOST_SEED), whole("most", most, 1, 10**9)
    if within not in ("cells", "limit"):
        raise ValueError(f"within={within!r:.60}: choose cells or limit")
    if not 0 < error < 1:
        raise ValueError(f"error={error!r:.60}: give a probability above 0 and below 1")
    seen, sizes = _pair("observation", observation), _pair("image_size", image_size)
    data = Dataset.of(source, config, revision)
    both = [
        Evaluation.of(each, data, observation=kind, image_size=size, seed=seed)
        for each, kind, size in zip((policy, other), seen, sizes, strict=True)
    ]
    dataset = data.manifest.config
    cells = dataset.height * dataset.width
    steps = cells if within == "cells" else RULES.step_limit * cells
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(PURPOSE,)))
    fresh = Drawing(dataset).sample_test(rng)
    compared = Comparison(0, 0, 0, 0, steps, error)
    while compared.better is None and compared.labyrinths < most:
        drawn = list(islice(fresh, min(TOGETHER, most - compared.labyrinths)))
        solved = []
        for shown in both:
            arrays, player = LabyrinthArrays.of_labyrinths(drawn, shown.spec), shown.player
            if player.forgets and not compared.labyrinths:
                player.require_repeatable(arrays, ADVICE)
            solved.append(player.play_once(arrays, steps).solved)
        first, second = solved
        compared = Comparison(
            compared.labyrinths + len(drawn),
            compared.both + int((first & second).sum()),
            compared.wins + int((first & ~second).sum()),
            compared.losses + int((second & ~first).sum()),
            steps,
            error,
        )
    return compared


def _pair(name: str, value: Any) -> tuple[Any, Any]:
    """Return the values of an argument for both policies."""
    if not isinstance(value, tuple):
        return value, value
    if len(value) != 2:
        raise ValueError(f"{name}={value!r:.60}: give one value, or a pair")
    return value
