"""Tables for memorising.md, from receipts that `memorising.py` kept."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np
from kept_results import RESULTS
from memorising import REFERENCES, SIX, TWENTY, Asked, planned

from labyrinth_core.storage import File
from pipeline.machinery import table
from pipeline.results.leaderboard import name_of

Kept = dict[str, Any]
"""The JSON of a policy that was asked."""

HEADING = [
    *("policy", "seeds", "excess [95%]", "of most", "p", "own way", "p there"),
    *("SR", "known", "new"),
]


def headline() -> str:
    """Return the answer: which methods follow their own train, by how much, and what it costs."""
    asked = [each for each in kept() if each["method"] == "bc" and not each["options"]]
    asked = [each for each in asked if not each["dataset"]]
    receipts = [each["receipt"] for each in asked]
    found = sum(each["p"] < 1.5 / (1 + each["drawn"]) for each in receipts)
    points = [each["excess"] for each in receipts]
    share = np.mean([each["excess"] / each["most"] for each in receipts])
    trains = len({each["train"] for each in asked})
    known, new = (
        np.mean([each["test"][figure] for each in asked])
        for figure in ("sr_known_route", "sr_new_route")
    )
    others = [each for each in kept() if each["name"].startswith("method-")]
    ranks = [
        (each["receipt"]["p"], name_of(each["method"]))
        for each in sorted(others, key=_order)
        if each["method"] in SIX and each["method"] != "bc"
    ]
    follow = [rank for rank, _ in ranks if rank <= 0.05]
    named = [*dict.fromkeys(name for _, name in ranks)]
    planners, mappers = (
        [each["receipt"]["p"] for each in others if each["method"] == method]
        for method in ("planner", "mapper")
    )
    return (
        f"**Behavioural cloning follows what its own training set happened to show. {found} of "
        f"{len(asked)} networks, on {trains} training sets of 100 labyrinths of 5x5, follow their "
        f"own set more than any of 200 others that the same distribution gives (p = 0.005): in "
        f"{min(points):.1f} to {max(points):.1f} more of 100 states of `test` than these explain, "
        f"{share:.0%} of what a policy would reach that always did. So do {len(follow)} of "
        f"{len(ranks)} networks of {', '.join(named[:-1])} and {named[-1]} (p up to "
        f"{max(follow):.3f}). {_none_or_some('planner', planners)} and "
        f"{_none_or_some('mapper', mappers)} are at p up to 0.05. "
        f"The BC networks solve {known:.0%} of `test` where an optimal route was demonstrated and "
        f"{new:.0%} elsewhere; the planner and the mapper all.**"
    )


def _none_or_some(method: str, ranks: Sequence[float]) -> str:
    """Return how many networks of a method follow their train at p up to 0.05."""
    return (
        f"{sum(rank <= 0.05 for rank in ranks)} of {len(ranks)} of the {method} "
        f"(p = {min(ranks):.3f} to {max(ranks):.3f})"
    )


def methods() -> str:
    """Return the table of policies with and without training."""
    found = [each for each in kept() if each["name"].startswith(("method", *_references()))]
    groups = groupby(sorted(found, key=_order), lambda each: each["method"])
    rows = [_row(_named(method), list(group)) for method, group in groups]
    if others := _asked_about_others():
        rows.append(_row("BC, each on another train", others))
    remembered = [each for each in kept() if each["name"].startswith("route-memory-of")]
    rows.append(_row("route memory, each on another train", remembered))
    return table(HEADING, rows, "l" + "r" * (len(HEADING) - 1))


def conditions() -> str:
    """Return the table of BC policies after other numbers of labyrinths and epochs, if any."""
    rows = []
    for each in kept():
        what, _, number = each["name"].partition("-bc-")
        title = {
            "labyrinths": f"{number} labyrinths",
            "epochs": f"{number} epochs",
            "noise": "noise 0.3",
            "method": "100 labyrinths, 100 epochs" if number == "0" else "",
        }.get(what, "")
        if title:
            rows.append(_row(title, [each]))
    if len(rows) < 2:
        return "Not asked yet: see the end of this page."
    return table(["BC", *HEADING[1:]], rows, "l" + "r" * (len(HEADING) - 1))


def validity() -> str:
    """Return the table of BC policies on their own trains, and on others."""
    rows = []
    for each in _asked_about_others():
        own, ps = each["receipt"], _ranks([each])
        rows.append(
            [
                str(each["train"]),
                _points([each]),
                f"{own['p']:.3f}",
                str(len(ps)),
                f"{ps.min():.3f}",
                f"{ps.mean():.2f}",
                f"{(ps <= 0.05).sum()}",
            ]
        )
    heading = [
        *("train, by seed", "excess on its own", "p"),
        *("unseen trains", "least p", "mean p", "p up to 0.05"),
    ]
    return table(heading, rows, "l" + "r" * (len(heading) - 1))


def uniform() -> str:
    """Say how far the ranks of unseen trains are from uniform, and what a train does to all."""
    found = _asked_about_others()
    ps = np.sort(_ranks(found))
    steps = np.arange(len(ps) + 1) / len(ps)
    apart = max(np.abs(ps - steps[1:]).max(), np.abs(ps - steps[:-1]).max())
    scaled = np.full((len(found), len(TWENTY)), np.nan)
    for row, each in enumerate(found):
        for seed, unseen in each["unseen"].items():
            scaled[row, TWENTY.index(int(seed))] = unseen["excess"] / unseen["sd"]
    scaled = scaled[:, (asked := (~np.isnan(scaled)).sum(axis=0)) > 0]
    by_train, expected = np.nanmean(scaled, axis=0), np.mean(asked[asked > 0] ** -0.5)
    return (
        f"Of {len(ps)} ranks, {(ps <= 0.05).mean():.1%} are up to 0.05 and "
        f"{(ps <= 0.1).mean():.1%} up to 0.1. Their largest distance from the uniform distribution "
        f"is {apart:.3f}; by Kolmogorov and Smirnov, {1.36 / np.sqrt(len(ps)):.3f} would be "
        f"significant at 5% if all were independent. The mean excess over the policies that never "
        f"saw a train, in standard deviations, differs between trains with a standard deviation of "
        f"{by_train.std(ddof=1):.2f}; independence would give {expected:.2f}."
    )


def missing() -> str:
    """Say which policies have not been asked."""
    names = {each["name"] for each in kept()}
    groups: dict[str, list[Asked]] = {}
    for each in planned():
        if each.name not in names:
            groups.setdefault(each.name.rpartition("-")[0], []).append(each)
    if not groups:
        return "Every planned policy was asked."
    rows = [
        [
            f"`{what}`",
            ", ".join(each.name.rpartition("-")[2] for each in group),
            f"{sum(each.hours for each in group):.2f}",
        ]
        for what, group in groups.items()
    ]
    return table(["not run yet", "which", "hours, about"], rows, "llr")


def kept() -> list[Kept]:
    """Return the policies that were asked, in the order of the plan."""
    paths = ((RESULTS / "memorising" / f"{each.name}.json") for each in planned())
    return [File(path).read_json() for path in paths if path.exists()]


def _references() -> list[str]:
    untrained = (*REFERENCES, "released")
    return [each.name for each in planned() if each.method in untrained and not each.train]


def _order(each: Kept) -> int:
    return [*REFERENCES, "released", *SIX, "planner", "mapper"].index(each["method"])


def _named(method: str) -> str:
    if method == "released":
        return "planner, released"
    return method if method in REFERENCES else name_of(method)


def _asked_about_others() -> list[Kept]:
    return [each for each in kept() if each["unseen"]]


def _ranks(found: Sequence[Kept]) -> np.ndarray:
    return np.array([unseen["p"] for each in found for unseen in each["unseen"].values()])


def _points(group: Sequence[Kept]) -> str:
    """Return the excess of one policy with its interval, or the mean of several."""
    if len(group) == 1:
        receipt = group[0]["receipt"]
        low, high = receipt["interval"]
        return f"{receipt['excess']:+z.2f} [{low:+z.2f}, {high:+z.2f}]"
    return f"{np.mean([each['receipt']['excess'] for each in group]):+z.2f}"


def _ranked(ranks: Sequence[float]) -> str:
    """Return each rank, or, of many, the least and the largest if they differ."""
    if len(ranks) > 1 and min(ranks) == max(ranks):
        return f"{ranks[0]:.3f} each"
    shown = ranks if len(ranks) <= 5 else [min(ranks), max(ranks)]
    return (", " if shown is ranks else " to ").join(f"{rank:.3f}" for rank in shown)


def _row(name: str, group: Sequence[Kept]) -> list[str]:
    receipts = [each["receipt"] for each in group]
    share = np.mean([each["excess"] / each["most"] for each in receipts])
    way = np.mean([each["own_way"]["excess"] for each in receipts])
    return [
        name,
        str(len(group)),
        _points(group),
        f"{share:z.1%}",
        _ranked([each["p"] for each in receipts]),
        f"{way:+z.2f}",
        _ranked([each["own_way"]["p"] for each in receipts]),
        *(
            f"{np.mean([each['test'][figure] for each in group]):.0%}"
            for figure in ("sr", "sr_known_route", "sr_new_route")
        ),
    ]
