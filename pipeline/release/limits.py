"""The limits and biases of datasets, as bullet points of a card."""

from __future__ import annotations

from collections.abc import Sequence

from labyrinth_core.data.splits import SHIFTS, SPLITS
from labyrinth_core.world.dynamics import Action
from pipeline.inspection.statistics import DatasetStatistics
from pipeline.release.texts import paragraph


def limits(datasets: Sequence[DatasetStatistics]) -> list[str]:
    """Return the limits of the configs of a folder, each in Markdown."""
    configs = [dataset.manifest.config for dataset in datasets]
    samplers = sorted({config.sampler for config in configs})
    others = ", ".join(f"`{sampler}`" for sampler in samplers if sampler != "wilson")
    forward = ", ".join(
        f"{dataset.splits['train'].action_shares[[Action.UP, Action.RIGHT]].sum():.0%} in "
        f"`{dataset.name}`"
        for dataset in datasets
        if dataset.manifest.config.goals == "fixed"
    )
    varied = names_of_varied(datasets)
    where = f"But for {varied}, in" if varied else "In"
    demonstrated = {"noise" if c.noise else f"solutions_{c.solutions}" for c in configs}
    same_size = len({(config.height, config.width) for config in configs}) < len(configs)
    apart = len({config.buckets for config in configs}) > 1
    walls = min(config.min_walls for config in configs)
    looks = [shift for shift in SHIFTS if SPLITS[shift].is_redrawn]
    looks = [f"`{shift}`" for shift in looks if any(shift in config.shifts for config in configs)]
    cut = sum(shard.cut for dataset in datasets for shard in dataset.manifest.shards)
    points = [
        paragraph("wilson") if "wilson" in samplers else "",
        paragraph("other_samplers", samplers=others) if others else "",
        paragraph("near", counted=_counted(datasets)) if walls == 1 else "",
        paragraph("farther", walls=str(walls)) if walls > 1 else "",
        paragraph("fixed_goals", where=where, forward=forward) if forward else "",
        paragraph("varied_goals", varied=varied) if varied else "",
        *(
            paragraph(name)
            for name in ("solutions_shortest", "solutions_all", "noise")
            if name in demonstrated
        ),
        paragraph("cut", cut=f"{cut:,}") if cut else "",
        paragraph("looks", looks=" and ".join(looks)) if looks else paragraph("one_renderer"),
        paragraph("deterministic_noise" if "noise" in demonstrated else "deterministic"),
        paragraph("random_is_cut"),
        paragraph("same_size_apart" if apart else "same_size") if same_size else "",
    ]
    return [point for point in points if point]


def names_of_varied(datasets: Sequence[DatasetStatistics]) -> str:
    """Return the names of the configs in which start and goal vary, in Markdown, empty if none."""
    return ", ".join(f"`{d.name}`" for d in datasets if d.manifest.config.goals == "varied")


def _counted(datasets: Sequence[DatasetStatistics]) -> str:
    """Return how many labyrinths of test are a wall away from train; empty if not analysed."""
    near = "; ".join(
        f"`{dataset.name}` {pair['within']['1']:,} of {dataset.analysis['labyrinths']['test']:,}"
        for dataset in datasets
        if dataset.analysis
        for pair in dataset.analysis["pairs"]
        if (pair["first"], pair["second"]) == ("train", "test")
    )
    return f": {near} do" if near else ""
