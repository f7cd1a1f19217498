"""Measure the size of the report on many labyrinths, and the time until it is usable.

    python scripts/benchmark_report.py            # 100,000 labyrinths of 5x5
    python scripts/benchmark_report.py --size 25 --labyrinths 20000

A dataset with so many pictures would take long to build, so the labyrinths are sampled here and
packed by the report's own functions, together with evaluations of runs that fail on half of them.
The times are measured by Chromium: from the start of the navigation to the first contentful paint,
and until the gallery shows labyrinths and responds; medians of several openings, each in a context
of its own.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import tempfile
import time
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser, sync_playwright

from labyrinth_core.data.manifest import Manifest, Shard
from labyrinth_core.data.splits import BASE_SPLITS
from labyrinth_core.evaluation.baselines import BASELINES
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS
from labyrinth_core.language.text import dump
from labyrinth_core.world.grid import parse_size
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.rollout import random_episode
from labyrinth_core.world.sampling import sample_structures
from labyrinth_core.world.solver import shortest_route
from labyrinth_core.world.tasks import default_start_and_goal
from pipeline.config.run import RunConfig, resolve
from pipeline.inspection.certificate import Certificate
from pipeline.inspection.counts import count_routes
from pipeline.inspection.routes import Route, routes
from pipeline.inspection.statistics import DatasetStatistics
from pipeline.machinery.evaluation_file import FORMAT
from pipeline.report.findings import SCORES, read_results
from pipeline.report.packing import PackedSplit, pack_routes
from pipeline.report.report import PACKED_BYTES, PAGE, describe, page

RANDOM_STEPS = 100
METHODS, SEEDS = 7, 3
"""The number of methods of the runs, and of seeds of each method."""

TIMES = """async () => {
  const paint = await new Promise((resolve) => {
    const painted = (list) =>
      list.getEntriesByName("first-contentful-paint").forEach((entry) => resolve(entry.startTime));
    new PerformanceObserver(painted).observe({ type: "paint", buffered: true });
  });
  const usable = performance.getEntriesByName("usable")[0].startTime;
  const id = window.labyrinths.BLOCKS.at(-1).hex("id", 0);
  const began = performance.now();
  const box = document.querySelector("input[name=id]");
  box.value = id;
  box.dispatchEvent(new Event("input", { bubbles: true }));
  const found = performance.now() - began;
  return { paint, usable, found };
}"""


def episodes(
    split: str, size: tuple[int, int], count: int
) -> Iterator[tuple[str, list[int], float]]:
    """Yield the text of a labyrinth, the actions and no return, of so many episodes."""
    rng = np.random.default_rng(list(BASE_SPLITS).index(split))
    structures = sample_structures(*size, rng)
    for structure in (next(structures) for _ in range(count)):
        labyrinth = Labyrinth(structure, *default_start_and_goal(*size))
        if split == "random":
            actions = random_episode(labyrinth, rng, RANDOM_STEPS).actions.tolist()
        else:
            actions = shortest_route(labyrinth, rng)
        yield dump(labyrinth), actions, 0.0


def sampled(size: tuple[int, int], labyrinths: int) -> dict[str, list[Route]]:
    """Return the routes of six splits that hold so many labyrinths together."""
    each = labyrinths // len(BASE_SPLITS)
    return {split: list(routes(episodes(split, size, each))) for split in BASE_SPLITS}


def shard_of(split: str, labyrinths: int) -> Shard:
    """Return the shard of a split as a manifest would describe it."""
    path = f"{split}-00000-of-00001.parquet"
    return Shard(path, split, labyrinths, labyrinths, 0, 0, 0, 0, "", split)


def evaluated(manifest: Manifest, splits: Mapping[str, PackedSplit]) -> list[dict[str, Any]]:
    """Return the page's results of runs that each failed on half of the labyrinths."""
    rng = np.random.default_rng(0)
    about = {"config": manifest.config.name, "fingerprint": manifest.fingerprint, "settings": {}}
    about |= {"method": "bc", "encoder": "cnn", "pool_stride": 1, "protocol": "default"}
    training = {"epochs": 1, "seconds": 1, "selected": {"epoch": 1}, "computed": {"device": "cpu"}}
    figures = dict.fromkeys(SCORES, 0.5) | {"failures": {"loop": 1}}
    figures |= {"sr_interval": [0.4, 0.6], "aer_interval": [0.4, 0.6]}
    rates = {name: {"sr": 0.9, "aer": -0.5, "aer_std": 1.0} for name in BASELINES}
    with tempfile.TemporaryDirectory() as folder:
        for method, seed in product(range(METHODS), range(SEEDS)):
            told = {}
            for split in EVALUATED_SPLITS:
                ids = bytes(splits[split].fixed["id"])
                solved = rng.random(len(ids) // 8) < 0.5
                failed = [ids[8 * at : 8 * at + 8].hex() for at in np.flatnonzero(~solved)]
                outcomes = "".join("ls"[won] for won in solved.tolist())
                count = len(outcomes)
                told[split] = figures | {"outcomes": outcomes, "failed": failed}
                told[split] |= {"labyrinths": count, "moves": [8] * count}
                told[split] |= {"by_distance": {"8": [count - len(failed), count]}}
            path = Path(folder) / "config" / f"method{method}-seed{seed}" / "evaluation.json"
            path.parent.mkdir(parents=True)
            content = {"format": FORMAT, "run": about | {"seed": seed}, "training": training}
            content["splits"] = told
            content["baselines"] = dict.fromkeys(EVALUATED_SPLITS, rates)
            path.write_text(json.dumps(content), encoding="utf-8")
        return read_results(Path(folder), [manifest])


def opened(browser: Browser, path: Path) -> dict[str, Any]:
    """Return the times of one opening of a page, in milliseconds."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    tab = context.new_page()
    tab.goto(path.as_uri())
    times: dict[str, Any] = tab.evaluate(TIMES)
    context.close()
    return times


def main() -> None:
    """Make the page, open it, and print the measurements."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--labyrinths", type=int, default=100_000)
    parser.add_argument("--size", default="5", help="rows and columns, as for run.py")
    parser.add_argument("--openings", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="6,000 labyrinths")
    options = parser.parse_args()
    labyrinths = 6_000 if options.quick else options.labyrinths
    began = time.perf_counter()
    size = parse_size(options.size)
    found = sampled(size, labyrinths)
    counts = {split: count_routes(of_split, size).counts for split, of_split in found.items()}
    config = resolve(RunConfig(stages=["report"], size=options.size, data_dir="-")).dataset
    limit = PACKED_BYTES // len(BASE_SPLITS)
    # Those that the page does not show are evaluated, too.
    splits = {split: pack_routes(of_split, 10**12) for split, of_split in found.items()}
    shards = tuple(shard_of(name, split.labyrinths) for name, split in counts.items())
    manifest = Manifest(config, {}, shards)
    dataset = DatasetStatistics(manifest, counts, Certificate({}, {}, (), {}))
    told = describe(dataset, splits, limit)
    text = page([told], evaluated(manifest, splits))
    seconds = time.perf_counter() - began
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        path = Path(folder) / PAGE
        path.write_text(text, encoding="utf-8")
        megabytes = path.stat().st_size / 1e6
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"))
        runs = [opened(browser, path) for _ in range(options.openings)]
        version = browser.version
        browser.close()
    median = {name: statistics.median(run[name] for run in runs) for name in runs[0]}
    held, shown = (sum(split[name] for split in told["splits"]) for name in ("labyrinths", "shown"))
    print(
        f"{held:,} labyrinths of {config.name}, {shown:,} of them in the page; Chromium {version}"
    )
    print(f"  {METHODS * SEEDS} runs of {METHODS} methods on them")
    print(f"  sampled, solved, packed  {seconds:8.1f} s")
    print(f"  index.html               {megabytes:8.1f} MB")
    print(f"  first contentful paint   {median['paint']:8.0f} ms")
    print(f"  gallery usable           {median['usable']:8.0f} ms")
    print(f"  one found by its id      {median['found']:8.0f} ms")


if __name__ == "__main__":
    main()
