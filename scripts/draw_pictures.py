"""Draw the pictures of the README: an animation of the tasks, and a screenshot of a report.

python scripts/draw_pictures.py
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

from labyrinth_core.pictures import animate
from labyrinth_core.world import Episode, Placer, Solver, Structure, Task
from pipeline.command.composed import ALL, resolve
from pipeline.generation import build
from pipeline.report import report

FOLDER = Path(__file__).parents[1] / "docs" / "pictures"
SEED = 4


def optimal_episode(task: Task, size: int) -> Episode:
    """Return an optimal episode that is not too short."""
    rng = np.random.default_rng(SEED)
    structures = Structure.sample(size, size, rng)
    for labyrinth in Placer(rng).labyrinths(structures, task, (0, size * size - 1)):
        episode = labyrinth.replay(Solver(labyrinth).shortest_route(rng))
        if len(episode) >= 2 * size:
            return episode
    raise AssertionError("the sampler never ends")


def draw_tasks() -> None:
    """Write an animated GIF with an optimal episode of each task."""
    episodes = [optimal_episode(task, 5) for task in Task]
    (FOLDER / "tasks.gif").write_bytes(animate(*episodes, image_size=200))


def draw_report() -> None:
    """Take a screenshot of the gallery of a report with an episode open, in Chromium."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        options = {"stages": ["build", "report"], "labyrinths": 30, "data_dir": folder}
        for task in (Task.NAVIGATION, Task.KEY_AND_DOOR):
            jobs = resolve(ALL(**options, task=str(task)))
            build.run(jobs["build"])
        report.run(jobs["report"])
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"))
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto((Path(folder) / report.FOLDER / report.PAGE).as_uri())
        page.select_option("select[name=task]", str(Task.KEY_AND_DOOR))
        page.locator(".tile").nth(3).click()
        for _ in range(4):
            page.locator("#forth").click()
        page.screenshot(path=FOLDER / "report.png")
        browser.close()


def main() -> None:
    """Write both pictures."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    draw_tasks()
    draw_report()


if __name__ == "__main__":
    main()
