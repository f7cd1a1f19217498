"""The section of a dataset's card on what its splits have in common."""

from __future__ import annotations

from collections.abc import Sequence

from labyrinth_core.data.manifest import ANALYSIS
from pipeline.inspection.statistics import DatasetStatistics
from pipeline.machinery.markdown import table
from pipeline.release.limits import names_of_varied


def uniqueness(datasets: Sequence[DatasetStatistics]) -> str:
    """Return the section, in Markdown; the numbers are those that replaying every file gave."""
    rows = []
    for dataset in datasets:
        held = {name: f"{split.labyrinths:,}" for name, split in dataset.splits.items()}
        for pair in dataset.certificate.pairs:
            splits = f"`{pair.first}`, `{pair.second}`"
            both = f"{held[pair.first]} and {held[pair.second]}"
            shared = f"{len(pair.equal):,}", f"{len(pair.mirrored):,}"
            rows.append((f"`{dataset.name}`", splits, both, *shared))
    varied = names_of_varied(datasets)
    turned = (
        f"""

Where start and goal vary ({varied}), any rotation or reflection of a structure may be the same
labyrinth again. There, no rotation or reflection of a structure of `train`, `validation` or `test`
is in another of the three."""
        if varied
        else ""
    )
    heading = ("config", "splits", "structures", "in both", "in both, or as a mirror image")
    return f"""## No structure in two splits

Which of `train`, `validation` and `test` a structure may be in follows from a hash of its
canonical form, the smaller of it and its mirror image that keeps start and goal in place. So a
structure cannot be in two of them, neither here nor in a dataset of another seed or length with
the same `buckets`. This is what the text in `info` says, read from every file here:

{table(heading, rows, "llrrr")}

No split with structures of its own repeats one, and those of `random`, `s0` and `s0_and_g` are all
structures of `train`.{turned}{_closeness(datasets)}"""


def _closeness(datasets: Sequence[DatasetStatistics]) -> str:
    """Return the paragraphs on how near the splits are, empty if that was not found out."""
    rows = [
        (
            f"`{dataset.name}`",
            f"`{pair['first']}`, `{pair['second']}`",
            f"{dataset.analysis['labyrinths'][pair['second']]:,}",
            f"{pair['counts']['symmetric']:,}",
            *(f"{count:,}" for count in pair["within"].values()),
            f"{pair['counts']['same_route']:,}",
            pair["spread"],
        )
        for dataset in datasets
        if dataset.analysis
        for pair in dataset.analysis["pairs"]
    ]
    if not rows:
        return ""
    walls = ("1 wall away", "2 walls", "3 walls")
    counts = table(
        ("config", "splits", "of", "turned", *walls, "same route", "walls to the nearest"),
        rows,
        "llrrrrrrr",
    )
    return f"""

Structures of two splits can be alike all the same. Of the labyrinths of the second split, so many
have in the first one

- *turned*: a structure that any rotation or reflection makes the same;
- *1 wall away*, *2 walls*, *3 walls*: one that differs in at most so many walls, without being
  turned;
- *same route*: a labyrinth in which an optimal route of theirs is optimal, too.

The last column is how many walls the nearest structure of the first split is away, least and
median. `{ANALYSIS}` in each config's folder has the ids, and the shift between the splits with its
p-values.

{counts}"""
