"""The build: sample, solve, render and write, composed; then the manifest, last of all.

Work happens beside the target, in `.NAME.building`, and the finished folder is moved into place.
A build that was stopped leaves its finished shards there, and the next one with the same
configuration goes on from them.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from labyrinth_core.labyrinth import Structure
from pipeline import front_matter
from pipeline.config import DatasetConfig, Run
from pipeline.executor import ordered_map
from pipeline.generation.render import render
from pipeline.generation.sample import ACTING, check_capacity, item_rng, labyrinth_of, sample
from pipeline.generation.solve import solve
from pipeline.generation.write import write
from pipeline.manifest import (
    MANIFEST,
    DatasetError,
    Manifest,
    Shard,
    current_versions,
    file_sha256,
    write_text,
)
from pipeline.schema import SAMPLED_SPLITS, SPLITS, Row
from pipeline.terminal import console, progress, summary, tracked

CELLS_PER_SHARD = 400_000
"""Cells of all labyrinths in a shard: 16,000 labyrinths at 5x5, some tens of megabytes."""

_CONFIG = "config.json"


@dataclass(frozen=True)
class ShardJob:
    """All that a worker needs to know to make one shard; the same job, the same bytes."""

    config: DatasetConfig
    split: str
    first: int
    """Place of its first labyrinth in the split."""
    structures: list[Structure]
    path: Path

    @property
    def sidecar(self) -> Path:
        """The file that says the shard is finished, and what it holds."""
        return self.path.with_suffix(".json")


def run(run: Run) -> None:
    """Build the dataset of a run, unless it is there already.

    Raises:
        ConfigError: There are not as many labyrinths as asked for.
        DatasetError: The folder holds another dataset, or something else.
        OSError: The folder cannot be written.
    """
    manifest = None if run.overwrite else _finished(run)
    if manifest is not None:
        console.print(f"{run.folder} is complete already.", highlight=False, soft_wrap=True)
    else:
        check_capacity(run.dataset)
        front_matter.check_replaceable(run.data_dir)
        building = run.data_dir / f".{run.dataset.name}.building"
        new_parents = [folder for folder in building.parents if not folder.exists()]
        try:
            manifest = _build(run, building)
        except OSError as error:
            if not _removed(building, new_parents):
                reason = f"{error}; finished shards are kept in {building} for the next run"
                raise DatasetError(reason) from error
            raise
        except BaseException:
            _removed(building, new_parents)
            raise
        _move_into_place(building, run.folder)
    front_matter.update(run.data_dir)
    console.print(summary(manifest))
    _report_cut(manifest)
    console.print(f'load_dataset("{run.data_dir}", "{run.dataset.name}")', soft_wrap=True)


def _finished(run: Run) -> Manifest | None:
    """Return the manifest of a dataset that was built with the same options before."""
    folder = run.folder
    if not (folder / MANIFEST).is_file():
        if folder.exists() and any(folder.iterdir()):
            raise DatasetError(
                f"{folder} holds files but no finished dataset: move them, choose another "
                "data_dir, or give overwrite=true to replace them"
            )
        return None
    manifest = Manifest.read(folder)
    there, wanted = asdict(manifest.config), asdict(run.dataset)
    differing = [
        f"{key}={there[key]}, not {wanted[key]}" for key in there if there[key] != wanted[key]
    ]
    if differing:
        raise DatasetError(
            f"{folder} holds a dataset with {'; '.join(differing)}: "
            "choose another data_dir, or give overwrite=true to replace it"
        )
    return manifest


def _sample(config: DatasetConfig) -> dict[str, list[Structure]]:
    with progress() as bars:
        bar = bars.add_task("sample", total=config.labyrinths * len(SAMPLED_SPLITS))
        return sample(config, lambda: bars.advance(bar))


def _build(run: Run, building: Path) -> Manifest:
    _prepare(building, run.dataset)
    jobs = list(_jobs(run.dataset, _sample(run.dataset), building))
    shards = ordered_map(make_shard, jobs, run.workers)
    done = tracked(
        ((shard.labyrinths, shard) for shard in shards),
        "build",
        total=run.dataset.labyrinths * len(SPLITS),
    )
    manifest = Manifest(run.dataset, current_versions(), tuple(done))
    manifest.write(building)
    for job in jobs:
        job.sidecar.unlink()
    (building / _CONFIG).unlink()
    return manifest


def _prepare(building: Path, config: DatasetConfig) -> None:
    """Make the folder, emptied of what another configuration or version left in it."""
    content = json.dumps({"config": config.to_json(), "versions": current_versions()})
    try:
        unchanged = (building / _CONFIG).read_text(encoding="utf-8") == content
    except FileNotFoundError:
        unchanged = False
    if building.exists() and not unchanged:
        shutil.rmtree(building)
    building.mkdir(parents=True, exist_ok=True)
    if not unchanged:
        write_text(building / _CONFIG, content)


def _jobs(
    config: DatasetConfig, structures: dict[str, list[Structure]], folder: Path
) -> Iterator[ShardJob]:
    size = max(1, CELLS_PER_SHARD // (config.height * config.width))
    count = -(-config.labyrinths // size)
    for split in SPLITS:
        of_split = structures[split if split in SAMPLED_SPLITS else "train"]
        for number in range(count):
            first = number * size
            yield ShardJob(
                config=config,
                split=split,
                first=first,
                structures=of_split[first : first + size],
                path=folder / f"{split}-{number:05d}-of-{count:05d}.parquet",
            )


def make_shard(job: ShardJob) -> Shard:
    """Make the shard of a job, or return the one that an earlier run has finished."""
    finished = _finished_shard(job)
    if finished is not None:
        return finished
    cut = 0

    def episodes() -> Iterator[list[Row]]:
        nonlocal cut
        config, split = job.config, job.split
        labyrinths = (
            (labyrinth_of(config, split, structure), item_rng(config, split, structure, ACTING))
            for structure in job.structures
        )
        for number, solution in enumerate(solve(config, split, labyrinths), start=job.first):
            cut += solution.cut
            yield from render(split, number, solution.episodes)

    written = write(job.path, episodes())
    shard = Shard(
        path=job.path.name,
        split=job.split,
        labyrinths=len(job.structures),
        cut=cut,
        **asdict(written),
    )
    write_text(job.sidecar, json.dumps(asdict(shard)))
    return shard


def _finished_shard(job: ShardJob) -> Shard | None:
    try:
        shard = Shard.from_json(json.loads(job.sidecar.read_bytes()))
        return shard if file_sha256(job.path) == shard.sha256 else None
    except (FileNotFoundError, ValueError, AttributeError):
        return None


def _move_into_place(building: Path, folder: Path) -> None:
    """Put the finished folder where it belongs.

    A crash between the two renames leaves the old dataset in `.NAME.replaced`.
    """
    if folder.exists():
        replaced = folder.with_name(f".{folder.name}.replaced")
        shutil.rmtree(replaced, ignore_errors=True)
        folder.replace(replaced)
        building.replace(folder)
        shutil.rmtree(replaced)
    else:
        building.replace(folder)


def _removed(building: Path, new_parents: list[Path]) -> bool:
    """Remove what a failed build left, unless a shard is finished; return whether it is gone."""
    if any(building.glob("*.parquet")):
        return False
    if building.is_dir():
        shutil.rmtree(building)
    for folder in new_parents:
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
    return True


def _report_cut(manifest: Manifest) -> None:
    cut: dict[str, Any] = {}
    for shard in manifest.shards:
        cut[shard.split] = cut.get(shard.split, 0) + shard.cut
    named = ", ".join(f"{count} of {split}" for split, count in cut.items() if count)
    if named:
        limit = manifest.config.solutions_limit
        console.print(f"solutions_limit={limit} left out routes of labyrinths: {named}.")
