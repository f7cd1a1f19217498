r"""Show trained policies other pictures, and let the planner raise costs to other powers.

    python scripts/studies/controls.py looks runs/5x5/planner-seed0 runs/5x5/bc-cnn-seed0 \
        --data-dir data/labyrinth --results results/controls/looks
    python scripts/studies/controls.py powers runs/5x5/planner-seed0 --data-dir data/labyrinth \
        --sizes 10 15 25 --results results/controls/powers

`looks` shows the labyrinths of test in other colours, and with walls of another thickness, to a
policy that was trained on the usual ones. `powers` tries other values of `method.sharpness` than
the run's, on validation, on test and on larger labyrinths. It also measures on validation, at the
size that was trained on, how much more a wall costs than a step. From that follows the power that
labyrinths of each size need (`needed`), which it tries as well. Policies have one view, as in
scripts/studies/generalise.py with `--once`. Results are a file for each run.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from math import log
from pathlib import Path
from typing import Any

import numpy as np
import torch
from labyrinth_sets import SEED, labyrinth_sets, write_results
from numpy.typing import NDArray

from labyrinth_core import load_policy
from labyrinth_core.data.observations import ObservationSpec
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays, as_arrays, load_arrays
from labyrinth_core.evaluation.playing import solved_by
from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import DEFAULT_STYLE, RECOLOURED, Style, render
from labyrinth_core.pictures.resize import area_average
from labyrinth_core.policies.networks.acting import NetworkPolicy
from labyrinth_core.policies.networks.network import as_input
from labyrinth_core.policies.networks.planning import Bellman, Planner
from labyrinth_core.policies.networks.symmetry import Averaged
from labyrinth_core.world.dynamics import State
from labyrinth_core.world.labyrinth import Labyrinth
from pipeline.config.training import IMAGE_SIZE
from pipeline.training.record import read_record

Drawn = Callable[[Labyrinth, State], NDArray[np.uint8]]

LIGHTER = 30
"""How many levels, of 255, the agent is lighter."""
THICKER = 5
"""By how many pixels a wall grows on either side; at 5x5 it has ten pixels of 120 of a cell."""
POWERS = (1.0, 2.0, 3.0, 5.0, 8.0)
TAIL = 0.001
"""The share of steps and walls that may cost more, and less, than the costs that are compared."""


def main() -> None:
    """Do what is asked for each run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["looks", "powers"])
    parser.add_argument("runs", type=Path, nargs="+", help="folders of finished runs")
    parser.add_argument("--data-dir", type=Path, required=True)
    parser.add_argument("--results", type=Path, required=True, help="folder for the files")
    parser.add_argument("--sizes", type=int, nargs="*", default=[], help="such as 10 15 25")
    given = parser.parse_args()
    torch.set_num_threads(1)
    for folder in given.runs:
        record = read_record(folder)
        if record is None:
            raise SystemExit(f"{folder} holds no finished run")
        about = {name: record["run"][name] for name in ("method", "config", "seed", "fingerprint")}
        kept = given.results / f"{folder.name}.json"
        looks_or_powers = looks if given.what == "looks" else powers
        looks_or_powers(given, folder, record["run"], about, kept)


def in_one_view(folder: Path) -> NetworkPolicy:
    """Return the policy of a run, which does not average over the symmetries of a picture."""
    policy = load_policy(folder)
    if isinstance(policy.network, Averaged):
        policy.network.symmetries = (0,)
    return policy


def looks(
    given: argparse.Namespace, folder: Path, run: dict[str, Any], about: dict[str, Any], kept: Path
) -> None:
    """Show the labyrinths of test to a policy in each of the looks."""
    policy = in_one_view(folder)
    arrays = load_arrays(given.data_dir, run["config"], "test", observation="vector")
    solved = {}
    for name, drawn in all_looks().items():
        shown = as_arrays(arrays.labyrinths, InLook(drawn))  # type: ignore[arg-type]
        solved[name] = solved_by(policy, shown).tolist()
        print(f"{folder.name}, {name}: {np.mean(solved[name]):.0%}", flush=True)
        write_results(kept, about, solved)


@dataclass(frozen=True)
class InLook:
    """What a policy is shown of labyrinths, whose states a function draws."""

    drawn: Drawn

    def look(self, views: Sequence[tuple[Labyrinth, State]]) -> NDArray[np.uint8]:
        """Return the pictures of states, shape (N, size, size, 3)."""
        return np.stack([self.drawn(*view) for view in views])


def all_looks() -> dict[str, Drawn]:
    """Return what draws a state in each of the looks, by name."""
    usual = DEFAULT_STYLE
    red, green, blue = (min(level + LIGHTER, 255) for level in usual.agent)
    colours = [field.name for field in fields(Style) if field.name != "wall_pixels"]
    opposite: dict[str, Any] = {
        name: tuple(255 - level for level in getattr(usual, name)) for name in colours
    }
    styles: dict[str, Style] = {
        "as trained": usual,
        "agent lighter": replace(usual, agent=(red, green, blue)),
        "start and goal exchanged": replace(usual, start=usual.goal, goal=usual.start),
        "inverted": replace(usual, **opposite),
        "recoloured": RECOLOURED,
        "grey floor": replace(usual, floor=(200, 200, 200)),
        "two-pixel walls": replace(usual, wall_pixels=2),
    }

    def in_style(style: Style) -> Drawn:
        return lambda labyrinth, state: render(labyrinth, state, IMAGE_SIZE, style)

    return {name: in_style(style) for name, style in styles.items()} | {"thick walls": thickened}


def thickened(labyrinth: Labyrinth, state: State) -> NDArray[np.uint8]:
    """Return the picture of a state with walls that are `THICKER` on either side."""
    picture = render(labyrinth, state, PICTURE_SIZE)
    channels = zip(np.moveaxis(picture, 2, 0), DEFAULT_STYLE.wall, strict=True)
    wall = np.logical_and.reduce([channel == level for channel, level in channels])
    for _ in range(THICKER):
        wall[1:] |= wall[:-1]
        wall[:-1] |= wall[1:]
        wall[:, 1:] |= wall[:, :-1]
        wall[:, :-1] |= wall[:, 1:]
    picture[wall] = DEFAULT_STYLE.wall
    return area_average(picture, IMAGE_SIZE)


def powers(
    given: argparse.Namespace, folder: Path, run: dict[str, Any], about: dict[str, Any], kept: Path
) -> None:
    """Let a planner plan with each of the powers, and with the one that each size needs."""
    policy = in_one_view(folder)
    trained_side = int(run["config"].partition("x")[0])
    bellman = next(each for each in policy.network.modules() if isinstance(each, Bellman))
    margin = margin_of(policy, load_arrays(given.data_dir, run["config"], "validation"))
    sides = [trained_side, *given.sizes]
    needed = {side: round(power_for(side, margin), 2) for side in sides}
    about |= {"margin": round(margin, 3), "needed": needed, "drawn_with_seed": SEED}
    print(f"{folder.name}: a wall costs {np.exp(margin):.1f} steps; needed: {needed}", flush=True)
    solved: dict[str, list[bool]] = {}
    wanted = ("validation", "test", *(f"fresh {side}x{side}" for side in given.sizes))
    for name, labyrinths in labyrinth_sets(given.data_dir, run["config"], sides=given.sizes):
        if name not in wanted:
            continue
        side = labyrinths[0].structure.height
        spec = ObservationSpec("image", round(IMAGE_SIZE * side / trained_side), draw=True)
        arrays = as_arrays(labyrinths, spec)
        for power in dict.fromkeys([*POWERS, needed[side]]):
            bellman.sharpness = power
            solved[f"{name} at {power:g}"] = solved_by(policy, arrays).tolist()
            share = np.mean(solved[f"{name} at {power:g}"])
            print(f"  {name} at {power:g}: {share:.0%}", flush=True)
            write_results(kept, about, solved)


def margin_of(policy: NetworkPolicy, arrays: LabyrinthArrays) -> float:
    """Return the logarithm of the cost of the cheapest wall, in most expensive steps.

    It is measured in the pictures of all states. A thousandth (`TAIL`) of the steps may cost more,
    and of the walls less. Outer walls do not count, since no way leads through them.
    """
    planner = next(each for each in policy.network.modules() if isinstance(each, Planner))
    bellman = planner.planning
    assert isinstance(bellman, Bellman)
    moves = np.array([labyrinth.structure.moves for labyrinth in arrays.labyrinths])
    height, width = (getattr(arrays.labyrinths[0].structure, name) for name in ("height", "width"))
    cells = np.arange(height * width).reshape(height, width)
    inside = np.zeros((height, width, 4), bool)
    inside[:-1, :, 0] = inside[:, :-1, 1] = inside[1:, :, 2] = inside[:, 1:, 3] = True
    wall = moves.reshape(-1, height, width, 4) == cells[..., None]
    with torch.no_grad():
        costs = torch.cat(
            [
                bellman.costs(planner.see(as_input(some)))[:, :4]
                for some in torch.from_numpy(arrays.observations).split(256)
            ]
        )
    found = costs.permute(0, 2, 3, 1).flip(1).numpy()  # Rows from the bottom, as in `moves`.
    walls = wall[arrays.labyrinth]
    highest = np.quantile(found[inside & ~walls], 1 - TAIL)
    lowest = np.quantile(found[inside & walls], TAIL)
    return float(lowest - highest)


def power_for(side: int, margin: float) -> float:
    """Return the least power with which a wall costs more than a way through all cells."""
    return log(side * side) / margin if margin > 0 else float("inf")


if __name__ == "__main__":
    main()
