"""Test a trained policy on labyrinths outside the dataset: new starts and goals, fresh, larger.

    python scripts/studies/generalise.py runs/5x5/planner-seed0 --data-dir data/labyrinth

Prints success rates with 95% bootstrap intervals: on the five splits; on the structures of
validation and test with another start and goal; on fresh labyrinths of another seed, as a check for
leakage; and, with `--sizes`, on larger ones. With `--looks`, test is shown in those of `looks.py`,
too, as it is and with new starts and goals; with `--moved`, down and to the right by some pixels,
the border repeated. Pictures are as large as the method wants them.
`--json FILE` keeps after each set which labyrinths were solved, and with the same other options
continues where it was stopped; `--pictures FOLDER` draws the failures.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from kept_results import read_run
from labyrinth_sets import SEED, labyrinth_sets, write_results
from looks import LOOKS, Look
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from labyrinth_core.evaluation.answers import Player
from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays, as_arrays
from labyrinth_core.evaluation.playing import attempts, play_once, step_through
from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import Painter, Style, render
from labyrinth_core.policies.networks.mapping import MapperPolicy
from labyrinth_core.policies.networks.symmetry import Averaged
from labyrinth_core.policies.spec import POLICY
from labyrinth_core.world.dynamics import State
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.rollout import Episode
from pipeline.config.run import RunConfig, resolve
from pipeline.training.methods.method import find
from pipeline.training.policy import read_policy
from pipeline.training.record import read_record
from pipeline.training.train import spec_of


def main() -> None:
    """Test the policy and print its success rates."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="folder of a finished run")
    parser.add_argument("--data-dir", type=Path, required=True)
    parser.add_argument("--sizes", type=int, nargs="*", default=[], help="such as 7 10 15 25")
    parser.add_argument("--labyrinths", type=int, default=100, help="fresh labyrinths of each size")
    parser.add_argument("--looks", action="store_true", help="show test in other looks, too")
    parser.add_argument("--moved", type=int, nargs="*", default=[], help="pixels, such as 12 20")
    parser.add_argument("--only", nargs="+", help="sets to test on, such as test (all)")
    parser.add_argument("--once", action="store_true", help="do not average over symmetries")
    parser.add_argument("--forget", action="store_true", help="of a mapper, take its memory away")
    parser.add_argument("--json", type=Path, help="file for which labyrinths were solved")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the failures")
    given = parser.parse_args()
    torch.set_num_threads(1)
    record = read_record(given.run)
    if record is None:
        raise SystemExit(f"{given.run} holds no finished run")
    make_player, image_size = policy_of(
        given.run, record["run"], once=given.once, forget=given.forget
    )
    about = {"run": record["run"], "drawn_with_seed": SEED, "in_one_view": given.once}
    about |= {"seconds_of_training": record["seconds"]}
    about |= {"without_memory": True} if given.forget else {}
    kept: dict[str, list[bool]] = {}
    if given.json is not None and given.json.exists():
        before = read_run(given.json)
        if before | about != before:
            raise SystemExit(f"{given.json} is of another run or test: give another file")
        kept = {name: which.tolist() for name, which in before["solved"].items()}
    config = record["run"]["config"]
    sets = labyrinth_sets(given.data_dir, config, sides=given.sizes, labyrinths=given.labyrinths)
    looks = LOOKS if given.looks else {}
    for name, labyrinths, styles, moved in shown(sets, looks, given.moved):
        if name in kept or (given.only and name not in given.only):
            continue
        structure = labyrinths[0].structure
        shape = (structure.height, structure.width)
        began = time.process_time()
        arrays = as_arrays(labyrinths, Drawing(labyrinths, styles, moved, image_size(*shape)))
        player = make_player(*shape)
        solved = solved_in(player, arrays)
        kept[name] = solved.tolist()
        low, high = interval(solved[None].astype(float))
        print(
            f"{name:36} {solved.mean():7.1%}  95% {100 * low:.0f}-{100 * high:.0f}  "
            f"of {len(solved)}, {time.process_time() - began:.0f} s of CPU",
            flush=True,
        )
        if given.json is not None:
            write_results(given.json, about, kept)
        if given.pictures is not None:
            folder = given.pictures / name.replace(", ", "-").replace(" ", "-")
            for number in np.flatnonzero(~solved).tolist():
                (episode,) = attempts(player, arrays, [number])
                draw_failure(folder, number, episode, styles[number])


def solved_in(player: Player, arrays: LabyrinthArrays) -> NDArray[np.bool_]:
    """Return which labyrinths a policy solves in as many steps as there are cells, shape (L,)."""
    if player.forgets:
        return play_once(player, arrays, arrays.cells).solved
    # One labyrinth at a time: a policy with a memory is shown all until the last one has ended.
    walked = step_through(player, arrays, 1, together=1)
    solved: NDArray[np.bool_] = walked.solved[0] & (walked.moves[0] <= arrays.cells)
    return solved


def shown(
    sets: Iterable[tuple[str, list[Labyrinth]]],
    looks: Mapping[str, Look],
    moved: Sequence[int],
) -> Iterator[tuple[str, list[Labyrinth], list[Style | None], int]]:
    """Yield sets of labyrinths with the style of each, and by how many pixels they are moved.

    Those of test come in some looks and moved, too.
    """
    for name, labyrinths in sets:
        usual: list[Style | None] = [None] * len(labyrinths)
        yield name, labyrinths, usual, 0
        if name in ("test", "test, new ends"):
            for look, styles in looks.items():
                rng = np.random.default_rng([SEED, len(name)])
                yield f"{name}, {look}", labyrinths, list(styles(labyrinths, rng)), 0
            for pixels in moved:
                yield f"{name}, moved by {pixels} pixels", labyrinths, usual, pixels


class Drawing:
    """What a policy is shown of labyrinths in a style each; None is that of the labyrinth."""

    def __init__(
        self,
        labyrinths: Sequence[Labyrinth],
        styles: Sequence[Style | None],
        moved: int,
        image_size: int,
    ) -> None:
        pairs = zip(labyrinths, styles, strict=True)
        self._painters = {id(each): Painter(each, style) for each, style in pairs}
        self._image_size, self._moved = image_size, moved

    def look(self, views: Sequence[tuple[Labyrinth, State]]) -> NDArray[np.uint8]:
        """Return the pictures of states, shape (N, image_size, image_size, 3)."""
        size = self._image_size
        pictures = np.stack([self._painters[id(each)].array(state, size) for each, state in views])
        here, edges = size - self._moved, ((0, 0), (self._moved, 0), (self._moved, 0), (0, 0))
        return np.pad(pictures[:, :here, :here], edges, "edge") if self._moved else pictures


def policy_of(
    folder: Path, run: dict[str, object], *, once: bool, forget: bool
) -> tuple[Callable[[int, int], Player], Callable[[int, int], int]]:
    """Return what makes the policy of a run for a size, and what tells its size of pictures."""
    size, _, task = str(run["config"]).partition("-")
    names = ["pool_stride", "observation", "protocol"]
    names += ["encoder"] * (run["method"] != run["encoder"])
    options = {name: run[name] for name in names}
    options |= {"task": task or "navigation", "method": {"name": run["method"]}}
    resolved = resolve(RunConfig(stages=["train"], size=size, **options))
    method, settings = find(str(run["method"]), run["settings"], str(run["protocol"]))  # type: ignore[arg-type]
    spec = spec_of(resolved)
    policy = read_policy(folder / POLICY, spec, make=partial(method.make, settings=settings))
    if once and isinstance(policy.network, Averaged):
        policy.network.symmetries = (0,)

    def player(height: int, width: int) -> Player:
        of_size = replace(spec, height=height, width=width)
        acting = method.player(policy, of_size, settings)
        if forget and isinstance(acting, MapperPolicy):
            acting.remember = False
        return Player.of(acting, 0)

    return player, partial(method.image_size, spec, settings)


def draw_failure(folder: Path, number: int, episode: Episode, style: Style | None) -> None:
    """Draw the last state of a failure with its path dotted, and print the reason."""
    last, before = episode.states[-1], episode.states[-2]
    how = "wall" if last == before else "loop or ice"
    print(f"  {folder.name}-{number}: {how} after {len(episode.states) - 1} moves")
    picture = Image.fromarray(render(episode.labyrinth, last, style=style))
    pen, structure = ImageDraw.Draw(picture), episode.labyrinth.structure
    pitch = PICTURE_SIZE / max(structure.height, structure.width)
    for state in episode.states[:-1]:
        row, column = episode.labyrinth.position(state.agent)
        x, y = (column + 0.5) * pitch, (structure.height - row - 0.5) * pitch
        pen.ellipse((x - pitch / 8, y - pitch / 8, x + pitch / 8, y + pitch / 8), fill="orange")
    folder.parent.mkdir(parents=True, exist_ok=True)
    picture.save(folder.parent / f"{folder.name}-{number}.png")


if __name__ == "__main__":
    main()
