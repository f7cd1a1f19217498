"""The text of a dataset's README.md, a pure function of its numbers and of the release."""

from __future__ import annotations

from collections.abc import Sequence

import yaml

from labyrinth_core.data import COLUMNS, SPLITS, TABLE_COLUMNS, Columns, Manifest
from labyrinth_core.evaluation import KnownDataset
from labyrinth_core.language import dump
from labyrinth_core.world import Action
from pipeline.inspection import Companion, DatasetStatistics, front_matter
from pipeline.machinery import count, plain, table
from pipeline.release.figures import BANNER, FIGURES, picture_path
from pipeline.release.texts import (
    Release,
    citation,
    code,
    command_lines,
    fill,
    paragraph,
    read,
    verbatim,
)

MOST_WORK = 2_000_000
"""The most labyrinths of test times their squared cells for which random steps are computed: the
time is proportional to it, some seconds. It is 200 labyrinths of 10 x 10 cells."""


def text(datasets: Sequence[DatasetStatistics], default: str, release: Release) -> str:
    """Return the generated text of the card.

    Args:
        datasets: The statistics of each config, the smallest first.
        default: The name of the default config.
        release: The release.
    """
    names = ", ".join(f"`{dataset.name}`" for dataset in datasets)
    shown = next(dataset for dataset in datasets if dataset.name == default)
    varied = _names_of_varied(datasets)
    first, mit = datasets[0], release.licence == front_matter.LICENCE
    splits = front_matter.splits_of([dataset.manifest for dataset in datasets])
    return fill(
        "dataset.md",
        banner=BANNER,
        rows=f"{sum(dataset.rows for dataset in datasets):,}",
        configs=count(len(datasets), "config"),
        names=f"{names}; `{default}` is the default" if len(datasets) > 1 else names,
        export=f"\n{paragraph('export', name=release.export)}" if release.export else "",
        hint="" if release.repo_id else f"\n{paragraph('hint', name=release.name)}\n",
        name=release.name,
        default=default,
        revision=f', revision="{release.version}"' if release.version else "",
        shard=shown.manifest.of("train")[0].path,
        columns=_meanings(COLUMNS),
        baselines=_baselines(datasets),
        varied=f" {paragraph('held_varied', varied=varied)}" if varied else "",
        splits=_splits(splits),
        counts=_rows(datasets, splits),
        labyrinth_table=_labyrinth_table(datasets, default, release),
        companions=_companions(datasets, release),
        commands="\n".join(command_lines(dataset.manifest.config) for dataset in datasets),
        made=_making(datasets),
        code=code(),
        pairs=_pairs(datasets),
        turned=f"\n\n{paragraph('turned', varied=varied)}" if varied else "",
        closeness=_closeness(datasets),
        statistics=_statistics(datasets, default),
        smallest=first.name,
        example=dump(first.splits["test"].examples[0].labyrinth).strip(),
        limits="\n".join(f"- {point}" for point in limits(datasets)),
        licence="[MIT](https://opensource.org/license/mit)."
        if mit
        else f"{verbatim(release.licence)}, as the head of this file says.",
        citation=citation(),
    )


def _splits(names: Sequence[str]) -> str:
    """Return the table of splits: what each holds, what is shifted, and what is held."""
    compared = yaml.safe_load(read("splits.yaml"))
    rows = ((f"`{name}`", SPLITS[name].meaning, *compared[name]) for name in names)
    return table(("split", "holds", "shifted", "held"), rows, "llll")


def _baselines(datasets: Sequence[DatasetStatistics]) -> str:
    """Return what route memory and random steps solve of test, without the largest datasets."""
    solved = []
    for dataset in datasets:
        size = dataset.manifest.config.height * dataset.manifest.config.width
        if dataset.splits["test"].labyrinths * size**2 <= MOST_WORK:
            known = KnownDataset(dataset.data).split("test").baselines
            figures = {
                "memory": known["route_memory"]["sr"],
                "random": known["random"]["sr"],
                "spl": known["random"]["spl"],
            }
            shares = {name: f"{share:.0%}" for name, share in figures.items()}
            solved.append(paragraph("baselines_of", config=dataset.name, **shares))
    return f"{paragraph('baselines', solved='; '.join(solved))}\n" if solved else ""


def _rows(datasets: Sequence[DatasetStatistics], splits: Sequence[str]) -> str:
    rows = [
        (
            f"`{split}`",
            *(f"{of.splits[split].rows:,}" if split in of.splits else "" for of in datasets),
        )
        for split in splits
    ]
    megabytes = (sum(shard.bytes for shard in of.manifest.shards) / 1e6 for of in datasets)
    rows += [
        ("all rows", *(f"{dataset.rows:,}" for dataset in datasets)),
        ("MB", *(f"{size:.2f}" for size in megabytes)),
    ]
    return table(("split", *(f"`{dataset.name}`" for dataset in datasets)), rows)


def _meanings(columns: Columns) -> str:
    """Return the table of the meanings of a dataset's columns."""
    return table(("column", "meaning"), ((f"`{c.name}`", c.meaning) for c in columns), "ll")


def _labyrinth_table(datasets: Sequence[DatasetStatistics], default: str, release: Release) -> str:
    """Return the section on the tables of labyrinths."""
    section = fill(
        "labyrinth_table.md",
        table=Manifest.TABLE,
        names=", ".join(f"`{front_matter.table_config(dataset.name)}`" for dataset in datasets),
        columns=_meanings(TABLE_COLUMNS),
        name=release.name,
        revision=f"@{release.version}" if release.version else "",
        shown=default,
    )
    return f"{section}\n"


def _companions(datasets: Sequence[DatasetStatistics], release: Release) -> str:
    """Return the sections on configs beside the datasets, such as questions."""
    manifests = [dataset.manifest for dataset in datasets]
    held = ((kind, kind.beside(manifests)) for kind in Companion.kinds())
    sections = (kind.section(own, release.name, release.version) for kind, own in held if own)
    return "".join(f"{section}\n" for section in sections)


def _making(datasets: Sequence[DatasetStatistics]) -> str:
    rows = (
        (
            f"`{dataset.name}`",
            plain(", ".join(f"{name} {v}" for name, v in dataset.manifest.versions.items())),
            f"`{dataset.manifest.fingerprint}`",
        )
        for dataset in datasets
    )
    return table(("config", "made with", "fingerprint of values and pixels"), rows, "lll")


def _pairs(datasets: Sequence[DatasetStatistics]) -> str:
    """Return the table of structures that splits share, counted from every file."""
    rows = (
        (
            f"`{dataset.name}`",
            f"`{pair.first}`, `{pair.second}`",
            " and ".join(f"{dataset.splits[s].labyrinths:,}" for s in (pair.first, pair.second)),
            f"{len(pair.equal):,}",
            f"{len(pair.mirrored):,}",
        )
        for dataset in datasets
        for pair in dataset.certificate.pairs
    )
    heading = ("config", "splits", "structures", "in both", "in both, or as a mirror image")
    return table(heading, rows, "llrrr")


def _closeness(datasets: Sequence[DatasetStatistics]) -> str:
    """Return the paragraphs on how near the splits are, empty if no dataset was analysed."""
    rows = [
        (
            f"`{dataset.name}`",
            f"`{pair['first']}`, `{pair['second']}`",
            f"{dataset.analysis['labyrinths'][pair['second']]:,}",
            f"{pair['counts']['symmetric']:,}",
            *(f"{number:,}" for number in pair["within"].values()),
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
    heading = ("config", "splits", "of", "turned", *walls, "same route", "walls to the nearest")
    counts = table(heading, rows, "llrrrrrrr")
    return "\n\n" + fill("closeness.md", analysis=Manifest.ANALYSIS, counts=counts).strip()


def _statistics(datasets: Sequence[DatasetStatistics], default: str) -> str:
    """Return the numbers and pictures of each config, collapsed except for the default."""
    parts = []
    for dataset in sorted(datasets, key=lambda dataset: dataset.name != default):
        section = f"{_numbers(dataset)}\n\n{_pictures(dataset)}"
        if dataset.name == default:
            parts.append(f"### {dataset.name}\n\n{section}")
        else:
            summary = f"<summary><b>{dataset.name}</b></summary>"
            parts.append(f"<details>\n{summary}\n\n{section}\n\n</details>")
    return "\n\n".join(parts)


def _numbers(dataset: DatasetStatistics) -> str:
    episodes = table(
        ("split", "labyrinths", "loops", "episodes", "rows", "moves", "longest", "return"),
        (
            (
                f"`{name}`",
                f"{split.labyrinths:,}",
                f"{split.mean_loops:.2f}",
                f"{split.episodes:,}",
                f"{split.rows:,}",
                f"{split.mean_moves:.2f}",
                f"{split.longest:,}",
                f"{split.mean_return:.3f}",
            )
            for name, split in dataset.splits.items()
        ),
    )
    actions = table(
        ("split", *(action.name.lower() for action in Action), "optimal", "choices"),
        (
            (
                f"`{name}`",
                *(f"{share:.1%}" for share in split.action_shares),
                f"{split.optimal_share:.1%}",
                f"{split.mean_choices:.2f}",
            )
            for name, split in dataset.splits.items()
        ),
    )
    return f"{episodes}\n\n{actions}"


def _pictures(dataset: DatasetStatistics) -> str:
    shown = [
        f"**{figure.title}.** {figure.caption}\n\n"
        f"![{figure.title} of {dataset.name}]({picture_path(dataset.name, name)})"
        for name, figure in FIGURES.items()
    ]
    if dataset.manifest.config.task.rules.hides:
        shown.insert(0, paragraph("hidden"))
    return "\n\n".join(shown)


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
    varied = _names_of_varied(datasets)
    where = f"But for {varied}, in" if varied else "In"
    demonstrated = {"noise" if c.noise else f"solutions_{c.solutions}" for c in configs}
    same_size = len({(config.height, config.width) for config in configs}) < len(configs)
    apart = len({config.buckets for config in configs}) > 1
    walls = min(config.min_walls for config in configs)
    looks = [shift for shift in SPLITS.shifts if SPLITS[shift].is_redrawn]
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


def _names_of_varied(datasets: Sequence[DatasetStatistics]) -> str:
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
