"""The limits and biases of datasets, as points for a card."""

from __future__ import annotations

from collections.abc import Sequence

from labyrinth_core.world.grid import Action
from pipeline.inspection.statistics import DatasetStatistics

_NOISE = "demonstrations.noise"
_OF_DEMONSTRATIONS = {
    "shortest": "With `solutions=shortest` a labyrinth has one demonstration, drawn uniformly from "
    "its shortest routes: where *choices* is above 1, an action that differs from the demonstrated "
    "one can be as good.",
    "all": "With `solutions=all` every route without repetition is a demonstration, also long "
    "ones: see *optimal* for how many actions begin a shortest route.",
    _NOISE: f"With `{_NOISE}` a demonstrator takes random actions now and then, and goes on "
    "optimally from where they lead: see *optimal* for how many actions begin a shortest route.",
}
"""Value of `solutions`, or the option that comes before it, -> a point that holds for it."""


def limits(datasets: Sequence[DatasetStatistics]) -> list[str]:
    """Return the points on the configs of a folder, in Markdown."""
    twins = "; ".join(
        f"`{dataset.name}` {pair['within']['1']:,} of {dataset.analysis['labyrinths']['test']:,}"
        for dataset in datasets
        if dataset.analysis
        for pair in dataset.analysis["pairs"]
        if (pair["first"], pair["second"]) == ("train", "test")
    )
    configs = [dataset.manifest.config for dataset in datasets]
    demonstrated = {_NOISE if config.noise else config.solutions for config in configs}
    points = [
        *_sampler_points(datasets),
        "Disjoint is not far apart. A structure of `test` can differ from one of `train` in a "
        f"single wall{f': {twins} do' if twins else ''}. Expect small sizes to flatter "
        "a method that interpolates.",
        *_goal_points(datasets),
        *(point for solutions, point in _OF_DEMONSTRATIONS.items() if solutions in demonstrated),
        "All splits are drawn by one renderer, in the same colours and at the same scale: "
        "a result says nothing about other pictures, and nothing about the real world.",
        "The environment is deterministic and no demonstration walks into a wall; states off the "
        "demonstrated routes are only in `random`, which is no demonstration.",
        "`random` is cut after a fixed number of steps, so its last episode of a labyrinth has "
        "mostly not reached the goal.",
    ]
    configs = [dataset.manifest.config for dataset in datasets]
    if len({(c.height, c.width) for c in configs}) < len(configs):
        same = len({c.buckets for c in configs}) == 1
        apart = "in different splits: do not learn on one and be judged on another."
        points.append(
            "Configs of one size that differ in their task may hold the same structure, "
            + ("always in the same split." if same else f"and, their `buckets` differing, {apart}")
        )
    return points


def _goal_points(datasets: Sequence[DatasetStatistics]) -> list[str]:
    shares = {
        dataset.name: dataset.splits["train"].action_shares[[Action.UP, Action.RIGHT]].sum()
        for dataset in datasets
        if dataset.manifest.config.goals == "fixed"
    }
    varied = names_of_varied(datasets)
    points = []
    if shares:
        forward = ", ".join(f"{share:.0%} in `{name}`" for name, share in shares.items())
        points.append(
            f"{f'But for {varied}, in' if varied else 'In'} `train`, `validation`, `test` and "
            "`random` the start is always bottom left and the "
            f"goal top right, so most demonstrated actions are up or right ({forward}): always "
            "compare with a policy that knows only this. `s0` and `s0_and_g` are there to take it "
            "away."
        )
    if varied:
        points.append(
            f"With `goals=varied` ({varied}) each labyrinth has a start and a goal of its own, in "
            "every split. So `s0` and `s0_and_g` ask about other ends in a structure of `train`, "
            "and no longer about a goal that never moved; figures are not to be compared with "
            "those of `goals=fixed`."
        )
    return points


def names_of_varied(datasets: Sequence[DatasetStatistics]) -> str:
    """Return the names of the configs in which start and goal vary, in Markdown, empty if none."""
    return ", ".join(f"`{d.name}`" for d in datasets if d.manifest.config.goals == "varied")


def _sampler_points(datasets: Sequence[DatasetStatistics]) -> list[str]:
    samplers = sorted({dataset.manifest.config.sampler for dataset in datasets})
    points = []
    if "wilson" in samplers:
        points.append(
            "Structures are not uniform over all connected ones. A spanning tree is drawn "
            "uniformly (Wilson's algorithm) and each remaining wall is opened with the probability "
            "`open_walls`: among structures with as many passages, one is the likelier the more "
            "spanning trees it has, and those with many loops are rare."
        )
    others = [f"`{sampler}`" for sampler in samplers if sampler != "wilson"]
    if others:
        points.append(
            f"The sampler {', '.join(others)} does not draw spanning trees uniformly: some kinds "
            "of labyrinths are much likelier than others."
        )
    return points
