"""Tables and a figure for benchmarks.md, from certificates that `certify_benchmarks.py` kept."""

from __future__ import annotations

from typing import Any

import numpy as np
from figures import COLOURS, INK
from kept_results import RESULTS
from matplotlib.figure import Figure

from labyrinth_core.benchmarks.environment import seeds_of
from labyrinth_core.benchmarks.levels import percent
from labyrinth_core.storage import File
from pipeline.machinery import table

Certificate = dict[str, Any]
"""The JSON of a certificate."""

MEASURES = ("first", "probes", "state")
HEADING = ["environment", "levels seen", "coverage", "at least", *MEASURES, "spread"]

LABELS = {"FrozenLake": "FrozenLake {}, map by seed", "Labyrinth": "Labyrinth {}"} | {
    "TwoSplits": "Labyrinth {}, split by seed"
}
"""How the name of a generated environment begins -> its name in the page."""

PUBLISHED = ("VAGEN", "RAGEN", "ReasoningGym")
"""How the names of environments begin whose projects publish the seeds of train and test."""

APART = 3.4
"""The least distance of two labels in the figure, in percent."""


def certified() -> str:
    """Return the table of environments with seeds of ours, those with the largest share first."""
    return table(HEADING, [row(each) for each in kept() if not is_published(each)])


def published() -> str:
    """Return the table of environments with the seeds that their projects train and test on."""
    heading = ["environment", "train seeds", "test seeds", "levels seen", "coverage", "at least"]
    rows = []
    for each in filter(is_published, kept()):
        levels, found = each["levels"], each["measures"][each["levels"]["by"]]
        trained = len(seeds_of(each["arguments"]["train"], "train"))
        numbers = [f"{trained:,}", f"{found['of']:,}", f"{levels['seen']:,}"]
        in_train = [f"{found['count']:,}", share(each, levels["by"])]
        rows.append([name(each), *numbers, *estimates(levels), *in_train])
    return table([*heading, "in train", "%"], rows)


def is_published(certificate: Certificate) -> bool:
    """Return whether the seeds of a certificate are those of the environment's project."""
    return name(certificate).startswith(PUBLISHED)


def procgen() -> str:
    """Return the table of Procgen's games at the sizes of its paper, by first pictures."""
    columns = ("easy-200", "hard-500")
    shares = {each["environment"].removeprefix("procgen-"): each for each in kept(records=True)}
    games = sorted({environment.partition("-")[0] for environment in shares})
    rows = [
        [game, *(share(shares[f"{game}-{column}"], "first") for column in columns)]
        for game in games
    ]
    rows.sort(key=lambda row: -max(float(cell.partition(" ")[0]) for cell in row[1:]))
    return table(["game", "easy, 200 train levels", "hard, 500 train levels"], rows)


def procgen_views() -> str:
    """Return the table of Procgen's games that show the whole level."""
    heading = ["game", "levels", "train levels", "test levels", "backgrounds"]
    rows = []
    for each in kept(records=True):
        _, game, mode, train, *looks = each["environment"].split("-")
        if looks:
            shown = "none" if "plain" in looks else "as usual"
            of, estimated = each["measures"]["first"]["of"], estimates(each["levels"])
            numbers = [f"{int(train):,}", f"{of:,}"]
            rows.append([game, mode, *numbers, shown, *estimated, share(each, "first")])
    return table([*heading, "coverage", "at least", "first"], rows)


def kept(records: bool = False) -> list[Certificate]:
    """Return the certificates of environments, or those of records, by descending share."""
    files = sorted((RESULTS / "benchmarks").glob("*.json"))
    found = [File(path).read_json() for path in files]
    chosen = [each for each in found if ("train" not in each["arguments"]) == records]
    return sorted(chosen, key=lambda each: (-best(each), name(each)))


def best(certificate: Certificate) -> float:
    """Return the share of test in train by the measure that tells levels apart."""
    return float(certificate["measures"][certificate["levels"]["by"]]["share"])


def name(certificate: Certificate) -> str:
    """Return the name of an environment in the page."""
    full: str = certificate["environment"].rpartition(":")[2].rpartition("-v")[0]
    if full == certificate["environment"].rpartition("-v")[0]:
        return full
    kind = full.rstrip("0123456789x")
    return LABELS.get(kind, "{}").format(full.removeprefix(kind) or full)


def row(certificate: Certificate) -> list[str]:
    """Return the row of an environment."""
    levels, spread = certificate["levels"], certificate["spread"]
    shares = [share(certificate, measure) for measure in MEASURES]
    spread = f"{100 * spread['share']:.2g}" if spread else ""
    return [name(certificate), f"{levels['seen']:,}", *estimates(levels), *shares, spread]


def estimates(levels: dict[str, Any]) -> list[str]:
    """Return the coverage in percent, and the lower bound of the number of levels."""
    if levels["once"] == levels["seeds"]:  # Chao1 would be a square of the number of seeds.
        return ["0", ""]
    return [percent(levels["coverage"]), f"{levels['at_least']:,}"]


def share(certificate: Certificate, measure: str) -> str:
    """Return the share of test in train by a measure, and its interval, in percent."""
    found = certificate["measures"].get(measure)
    if found is None:
        return "no share" if measure in certificate["reasons"] else ""
    low, high = map(percent, found["interval"])
    return f"{percent(found['share'])} [{low}, {high}]"


def draw() -> Figure:
    """Return a figure of the share of test in train by the number of training seeds.

    It has no environment that only first observations tell apart.
    """
    figure = Figure(figsize=(7.2, 6.4), layout="constrained")
    panel = figure.subplots()
    drawn = [each for each in kept() if best(each) > 0 and each["levels"]["by"] != "first"]
    heights: list[float] = []
    most = max(each["curves"][each["levels"]["by"]][-1][0] for each in drawn)
    for each in drawn:
        by = each["levels"]["by"]
        seeds, counts = np.array(each["curves"][by]).T
        shares = 100 * counts / each["measures"][by]["of"]
        ours = name(each).startswith("Labyrinth")
        colour, style = (COLOURS[0], "--") if ours else (COLOURS[1], "-")
        panel.plot(seeds, shares, style, color=colour, lw=1.2, alpha=0.8)
        heights.append(min(shares[-1], heights[-1] - APART if heights else shares[-1]))
        label = f"{name(each)}, {percent(shares[-1] / 100)}%"
        panel.annotate(
            label,
            (seeds[-1], shares[-1]),
            (most * 1.12, heights[-1]),
            va="center",
            fontsize=7.5,
            color=colour,
            arrowprops={"arrowstyle": "-", "color": INK, "lw": 0.4, "relpos": (0, 0.5)},
            annotation_clip=False,
        )
    panel.set_xscale("log")
    panel.xaxis.set_major_formatter("{x:,.0f}")
    panel.set(xlabel="training seeds", ylabel="% of test seeds whose level is in train")
    panel.set(xlim=(1, most), ylim=(min(0, heights[-1]) - 2, 103))
    panel.grid(alpha=0.3)
    return figure
