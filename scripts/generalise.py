"""Try a trained policy on labyrinths of no dataset: new ends, fresh ones, larger ones.

    python scripts/generalise.py runs/5x5/planner-seed0 --data-dir data/labyrinth

Prints success rates with 95% bootstrap intervals: on the split test; on the structures of
validation and test with another start and goal; on fresh labyrinths of another seed, as a check on
leaks; and, with `--sizes`, on larger ones. Pictures have the pixels a cell of those trained on.
`--json FILE` keeps which were solved, `--pictures FOLDER` draws what is lost, and how.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw

from labyrinth_core.labyrinth import Labyrinth
from labyrinth_core.renderer import PICTURE_SIZE, render
from labyrinth_core.sampling import default_open_walls, sample_structures
from labyrinth_core.tasks import change_start_and_goal, default_start_and_goal, place
from pipeline.bootstrap import interval
from pipeline.config import RunConfig, TaskConfig, resolve
from pipeline.manifest import write_text
from pipeline.training.journeys import Journey, travel
from pipeline.training.method import find
from pipeline.training.policy import NetworkPolicy, load_policy
from pipeline.training.record import POLICY, read_record
from pipeline.training.symmetry import Averaged
from pipeline.training.train import spec_of
from pipeline.training.worlds import load_worlds
from pipeline.training_config import IMAGE_SIZE


def main() -> None:
    """Try the policy and print how it went."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="folder of a finished run")
    parser.add_argument("--data-dir", type=Path, required=True)
    parser.add_argument("--sizes", type=int, nargs="*", default=[], help="such as 7 10 15 25")
    parser.add_argument("--labyrinths", type=int, default=100, help="fresh ones of each size")
    parser.add_argument("--seed", type=int, default=1_000_000, help="of what is drawn")
    parser.add_argument("--once", action="store_true", help="do not average over symmetries")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--json", type=Path, help="file for what was solved")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of what is lost")
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    record = read_record(given.run)
    if record is None:
        raise SystemExit(f"{given.run} holds no finished run")
    policy, side = policy_of(given.run, record["run"], once=given.once)
    pixels = IMAGE_SIZE / side
    kept: dict[str, list[bool]] = {}
    for name, labyrinths in drawn(given, record["run"]["config"]):
        size = labyrinths[0].structure.height
        began = time.process_time()
        journeys = travel(policy, labyrinths, round(pixels * size))
        kept[name] = [journey.solved for journey in journeys]
        solved = np.array([kept[name]], float)
        low, high = interval(solved)
        print(
            f"{name:24} {solved.mean():7.1%}  95% {100 * low:.0f}-{100 * high:.0f}  "
            f"of {len(journeys)}, {time.process_time() - began:.0f} s of CPU",
            flush=True,
        )
        if given.pictures is not None:
            draw_lost(given.pictures, name.replace(", ", "-").replace(" ", "-"), journeys)
    if given.json is not None:
        write_text(given.json, json.dumps(kept) + "\n")


def policy_of(folder: Path, run: dict[str, object], *, once: bool) -> tuple[NetworkPolicy, int]:
    """Return the policy of a run, and the side of the labyrinths that it was trained on."""
    size, _, task = str(run["config"]).partition("-")
    asked = RunConfig(
        stages=["train"], size=size, task=TaskConfig(task or "navigation"), data_dir="data"
    )
    asked.method = {"name": run["method"]}
    for name in ("encoder", "pool_stride", "observation", "protocol"):
        if name != "encoder" or run["method"] != run["encoder"]:
            setattr(asked, name, run[name])
    resolved = resolve(asked)
    method, settings = find(str(run["method"]), run["settings"])  # type: ignore[arg-type]
    make = partial(method.make, settings=settings)
    policy = load_policy(folder / POLICY, spec_of(resolved), make=make)
    if once and isinstance(policy.network, Averaged):
        policy.network.symmetries = (0,)
    return policy, max(resolved.dataset.height, resolved.dataset.width)


def drawn(given: argparse.Namespace, config: str) -> Iterator[tuple[str, list[Labyrinth]]]:
    """Yield the labyrinths to try, by name."""
    rng = np.random.default_rng(given.seed)
    splits = {
        split: load_worlds(given.data_dir, config, split, observation="vector").labyrinths
        for split in ("train", "validation", "test")
    }
    yield "test", list(splits["test"])
    for split in ("validation", "test"):
        yield f"{split}, new ends", [change_start_and_goal(each, rng) for each in splits[split]]
    known = {each.structure.canonical() for each in splits["train"]}
    like = splits["train"][0]
    for side in [like.structure.height, *given.sizes]:
        fresh = fresh_labyrinths(side, like, rng)
        unknown = (each for each in fresh if each.structure.canonical() not in known)
        yield f"fresh {side}x{side}", list(islice(unknown, given.labyrinths))


def fresh_labyrinths(side: int, like: Labyrinth, rng: np.random.Generator) -> Iterator[Labyrinth]:
    """Yield labyrinths of a size, of the task of another one."""
    walls = default_open_walls(side, side)
    start, goal = default_start_and_goal(side, side)
    for structure in sample_structures(side, side, rng, algorithm="wilson", open_walls=walls):
        try:
            yield place(structure, start, goal, like.task, rng)
        except ValueError:  # It cannot hold the task.
            continue


def draw_lost(folder: Path, name: str, journeys: list[Journey]) -> None:
    """Draw where each failure ends, the cells it went through dotted, and say what happened."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, journey in enumerate(journeys):
        if journey.solved:
            continue
        last, before = journey.states[-1], journey.states[-2]
        how = "wall" if last == before else "loop or ice"
        print(f"  {name}-{number}: {how} after {len(journey.states) - 1} moves")
        picture = Image.fromarray(render(journey.labyrinth, last))
        pen, structure = ImageDraw.Draw(picture), journey.labyrinth.structure
        pitch = PICTURE_SIZE / max(structure.height, structure.width)
        for state in journey.states[:-1]:
            row, column = journey.labyrinth.position(state.agent)
            x, y = (column + 0.5) * pitch, (structure.height - row - 0.5) * pitch
            pen.ellipse((x - pitch / 8, y - pitch / 8, x + pitch / 8, y + pitch / 8), fill="orange")
        picture.save(folder / f"{name}-{number}.png")


if __name__ == "__main__":
    main()
