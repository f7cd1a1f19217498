"""Tables for generalisation.md: the planner's seeds, control experiments, and related methods.

The results come from the stage `evaluate`, and from archived studies (docs/results/ARCHIVE.md).
`report_pages.py` writes the tables.
"""

from __future__ import annotations

from kept_results import grouped, read_runs, solved_in, whole
from report_ablation import shown

from pipeline.machinery import table
from pipeline.results.leaderboard import name_of


def planner_by_seed() -> str:
    """Return a table of three seeds on the splits, in eight views, and other sets, in one view."""
    runs = read_runs("runs/5x5", "planner-*.json")
    larger = read_runs("larger", "planner-*.json")
    splits = {name: shown(name) for name in ("train", "validation", "test", "s0", "s0_and_g")}
    other = {
        "validation, new ends": "structures of validation, new start and goal",
        "test, new ends": "structures of test, new start and goal",
        "fresh": "fresh labyrinths of another seed",
        **{f"fresh {size}": size for size in ("7x7", "10x10", "15x15", "25x25")},
    }
    heading = ["% solved, of 100", *(f"seed {run['run']['seed']}" for run in runs)]
    rows = [
        [name, *(whole(each["solved"][part].mean()) for each in group)]
        for group, parts in ((runs, splits), (larger, other))
        for part, name in parts.items()
    ]
    return table(heading, rows)


def exchanged() -> str:
    """Return a table of runs whose labels have two actions exchanged."""
    groups = grouped(read_runs("controls/exchanged/5x5"), "variant")
    rows = [
        [
            variant,
            *(whole(solved_in(group, name).mean()) for name in ("train", "test")),
            str(len(group)),
        ]
        for (variant,), group in groups.items()
    ]
    return table(["% solved", "train", "test", "seeds"], rows)


def powers() -> str:
    """Return a table of the planner's `sharpness`: fixed powers, and the power given by a rule."""
    (run,) = read_runs("controls/powers")
    of_sets: dict[str, dict[str, str]] = {}
    for name, solved in run["solved"].items():
        of_set, _, power = name.rpartition(" at ")
        of_sets.setdefault(of_set, {})[power] = whole(solved.mean())
    rows, tried = [], []
    for name, cells in of_sets.items():
        *tried, needed = cells
        by_rule = f"{cells[needed]} ({float(needed):.1f})"
        rows.append([name.removeprefix("fresh "), *(cells[power] for power in tried), by_rule])
    return table(["power", f"{tried[0]}, as learnt", *tried[1:], "by the rule"], rows)


def looks() -> str:
    """Return a table of success rates in other looks, with all seeds of a method in one cell."""
    runs = read_runs("controls/looks")
    methods, rows = ("planner", "bc"), []
    for look in runs[0]["solved"]:
        rates = (
            [whole(each["solved"][look].mean()) for each in runs if each["method"] == method]
            for method in methods
        )
        rows.append([look, *map(", ".join, rates)])
    return table(["look", *map(name_of, methods)], rows)


PEERS: dict[str, tuple[str, str]] = {
    "planner": ("runs/5x5", "planner-*.json"),
    "`walls`": ("peers/runs/5x5", "walls-*.json"),
    "`vin`, 30 epochs": ("peers/runs/5x5", "vin-*.json"),
    "the same with `augment` and `relabel`": ("peers/relabelled/5x5", "vin-*.json"),
    "`vin`, 400 epochs": ("peers/longer/5x5", "vin-*.json"),
}
"""Name in print -> the folder of the runs, and the pattern of their files."""


def peers() -> str:
    """Return a table of the planner and related methods on the splits."""
    splits, rows = ("train", "validation", "test", "s0", "s0_and_g"), []
    for name, (folder, pattern) in PEERS.items():
        runs = read_runs(folder, pattern)
        cells = (whole(solved_in(runs, split).mean()) for split in splits)
        rows.append([name, str(len(runs)), *cells])
    return table(["5x5, % solved", "seeds", *map(shown, splits)], rows)
