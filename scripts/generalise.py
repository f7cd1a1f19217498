"""Test a trained policy on labyrinths outside the dataset: new starts and goals, fresh, larger.

    python scripts/generalise.py runs/5x5/planner-seed0 --data-dir data/labyrinth

Prints success rates with 95% bootstrap intervals: on the five splits; on the structures of
validation and test with another start and goal; on fresh labyrinths of another seed, as a check for
leakage; and, with `--sizes`, on larger ones. Pictures have as many pixels per cell as those trained
on. `--json FILE` keeps which labyrinths were solved, `--pictures FOLDER` draws the failures.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path

import numpy as np
import torch
from labyrinth_sets import labyrinth_sets, write_results
from PIL import Image, ImageDraw

from labyrinth_core.evaluation.following import GreedyEpisode, greedy_episodes
from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import render
from labyrinth_core.policies.networks.acting import NetworkPolicy
from labyrinth_core.policies.networks.symmetry import Averaged
from pipeline.config.run import RunConfig, resolve
from pipeline.config.training import IMAGE_SIZE
from pipeline.machinery.evaluation_file import POLICY
from pipeline.training.methods.method import find
from pipeline.training.policy import load_policy
from pipeline.training.record import read_record
from pipeline.training.train import spec_of


def main() -> None:
    """Test the policy and print its success rates."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="folder of a finished run")
    parser.add_argument("--data-dir", type=Path, required=True)
    parser.add_argument("--sizes", type=int, nargs="*", default=[], help="such as 7 10 15 25")
    parser.add_argument("--labyrinths", type=int, default=100, help="fresh labyrinths of each size")
    parser.add_argument("--seed", type=int, default=1_000_000, help="of what is sampled")
    parser.add_argument("--once", action="store_true", help="do not average over symmetries")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--json", type=Path, help="file for which labyrinths were solved")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the failures")
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    record = read_record(given.run)
    if record is None:
        raise SystemExit(f"{given.run} holds no finished run")
    policy, side = policy_of(given.run, record["run"], once=given.once)
    pixels = IMAGE_SIZE / side
    kept: dict[str, list[bool]] = {}
    sets = labyrinth_sets(
        given.data_dir,
        record["run"]["config"],
        np.random.default_rng(given.seed),
        sides=given.sizes,
        labyrinths=given.labyrinths,
    )
    for name, labyrinths in sets:
        size = max(labyrinths[0].structure.height, labyrinths[0].structure.width)
        began = time.process_time()
        episodes = greedy_episodes(policy, labyrinths, round(pixels * size))
        kept[name] = [episode.solved for episode in episodes]
        solved = np.array([kept[name]], float)
        low, high = interval(solved)
        print(
            f"{name:24} {solved.mean():7.1%}  95% {100 * low:.0f}-{100 * high:.0f}  "
            f"of {len(episodes)}, {time.process_time() - began:.0f} s of CPU",
            flush=True,
        )
        if given.pictures is not None:
            draw_failures(given.pictures, name.replace(", ", "-").replace(" ", "-"), episodes)
    if given.json is not None:
        about = {"run": record["run"], "drawn_with_seed": given.seed, "in_one_view": given.once}
        write_results(given.json, about, kept)


def policy_of(folder: Path, run: dict[str, object], *, once: bool) -> tuple[NetworkPolicy, int]:
    """Return the policy of a run, and the size of the labyrinths that it was trained on."""
    size, _, task = str(run["config"]).partition("-")
    names = ["pool_stride", "observation", "protocol"]
    names += ["encoder"] * (run["method"] != run["encoder"])
    options = {name: run[name] for name in names}
    options |= {"task": task or "navigation", "method": {"name": run["method"]}}
    resolved = resolve(RunConfig(stages=["train"], size=size, **options))
    method, settings = find(str(run["method"]), run["settings"])  # type: ignore[arg-type]
    make = partial(method.make, settings=settings)
    policy = load_policy(folder / POLICY, spec_of(resolved), make=make)
    if once and isinstance(policy.network, Averaged):
        policy.network.symmetries = (0,)
    return policy, max(resolved.dataset.height, resolved.dataset.width)


def draw_failures(folder: Path, name: str, episodes: list[GreedyEpisode]) -> None:
    """Draw the last state of each failure with its path dotted, and print the reason."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, episode in enumerate(episodes):
        if episode.solved:
            continue
        last, before = episode.states[-1], episode.states[-2]
        how = "wall" if last == before else "loop or ice"
        print(f"  {name}-{number}: {how} after {len(episode.states) - 1} moves")
        picture = Image.fromarray(render(episode.labyrinth, last))
        pen, structure = ImageDraw.Draw(picture), episode.labyrinth.structure
        pitch = PICTURE_SIZE / max(structure.height, structure.width)
        for state in episode.states[:-1]:
            row, column = episode.labyrinth.position(state.agent)
            x, y = (column + 0.5) * pitch, (structure.height - row - 0.5) * pitch
            pen.ellipse((x - pitch / 8, y - pitch / 8, x + pitch / 8, y + pitch / 8), fill="orange")
        picture.save(folder / f"{name}-{number}.png")


if __name__ == "__main__":
    main()
