"""Train behavioural cloning and a value iteration network on the slots that the mapper sees.

    python scripts/studies/slot_controls.py --data-dir data/labyrinth --results docs/results/mapper

What do the slots, the steps and the variation of pictures of `method=mapper` give on their own? The
network of BC, or that of methods/vin.py, sees a mask for each slot in place of colours of pixels.
Where VIN has to know the cell of the agent, it learns which slot moves, as the mapper does.

Demonstrations alone say which action is right. The steps of the split `random` serve in another way
(`explore`): the network also predicts where the action of a step leads, from the picture before it.

Training ends when the success rate on validation has not risen in `PATIENCE` trials; the best
policy is kept, and tested once on labyrinths of generalise.py. A run whose file exists is skipped.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import product
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import torch
from generalise import Drawing, shown, solved_in
from labyrinth_sets import SEED, labyrinth_sets, write_results
from looks import LOOKS
from methods import vin
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils import clip_grad_norm_
from torch.optim import Adam

from labyrinth_core.evaluation.answers import Player, Policy
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays, as_arrays, load_arrays
from labyrinth_core.evaluation.playing import success_rate
from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import Style
from labyrinth_core.policies.networks import slots
from labyrinth_core.policies.networks.acting import NetworkPolicy
from labyrinth_core.policies.networks.mapping import AROUND, Mapper
from labyrinth_core.policies.networks.network import ACTIONS, Cnn, Network
from labyrinth_core.policies.networks.planning import on_grid
from labyrinth_core.policies.spec import NetworkSpec
from labyrinth_core.world.dynamics import State
from labyrinth_core.world.labyrinth import Labyrinth
from pipeline.config.run import RunConfig, resolve
from pipeline.config.training import PROTOCOLS
from pipeline.training.checkpoint import Progress
from pipeline.training.loop import fit
from pipeline.training.methods import mapper
from pipeline.training.methods.method import Problem, setting
from pipeline.training.methods.planner import MAX_GRADIENT
from pipeline.training.train import identify, prepare

CONFIG = "5x5"
SLOTS = 5
"""The number of masks: pictures of navigation have floor, wall, start, goal and agent."""
SIDE = 60
"""The blocks along the side of 5x5, to which BC sees other labyrinths resized."""
PATIENCE = 8
TESTED_LOOKS = {name: look for name, look in LOOKS.items() if name != "recoloured"}
MOVED = 12
UNTESTED = (
    "train",
    "validation",
    "s0",
    "validation, new ends",
    "test, new ends, moved by 12 pixels",
)

VARIANTS = {
    f"slots-{network}{name}": dict[str, Any](network=network, **values)
    for network in ("bc", "vin")
    for name, values in {
        "": dict[str, Any](),
        "-plain": {"shift": 0, "grow": 0},
        "-explore": {"explore": True},
    }.items()
}
"""Variant -> the settings that differ from those of its network and of the mapper."""
USUAL: dict[str, Any] = {"epochs": 400, "evaluate_every": 5, "explore": False}
AS_ON_PICTURES: dict[str, dict[str, Any]] = {
    "bc": {"batch_size": 64, "learning_rate": 0.0005},
    "vin": {"batch_size": 32, "learning_rate": 0.002},
}
"""Network -> settings."""


@dataclass(frozen=True)
class Settings(mapper.Settings):
    """An epoch is one pass over the demonstrated steps; `steps` and `overgrow` have no use."""

    network: str = setting("bc", "bc or vin")


class OnSlots(nn.Module):
    """A network that sees slots, and finds which one moves if it has to know."""

    def __init__(self, spec: NetworkSpec, settings: Settings) -> None:
        """Draw the weights."""
        super().__init__()
        self.slots = Mapper(settings) if settings.network == "vin" else None  # Only its `roles`.
        outputs = ACTIONS * (1 + len(AROUND) + 1)  # A score, and the outcomes as in `Mapper`.
        self.network: vin.ValueIteration | Network
        if settings.network == "vin":
            self.network = vin.ValueIteration(spec.height, vin.Settings(), SLOTS, outputs)
        else:
            self.network = Network(replace(spec, encoder="cnn"), outputs)
            self.network.encoder = Cnn(SLOTS)

    def forward(self, scenes: Tensor) -> Tensor:
        """Return the scores of the actions, shape (N, 4), from what `scene_of` returns."""
        outputs, _ = self.read(slots.masks_of(scenes.numpy()))
        return outputs[:, :ACTIONS]

    def read(self, masks: Tensor) -> tuple[Tensor, Tensor | None]:
        """Return the outputs, shape (N, 40), and the logits that a slot moves, shape (N, `SLOTS`).

        Args:
            masks: As `masks_of` returns them, with at most `SLOTS` slots.
        """
        masks = functional.pad(masks, (0, 0, 0, 0, 0, SLOTS - masks.shape[1]))
        if self.slots is None:
            return self.network(functional.adaptive_avg_pool2d(masks, SIDE)), None
        assert isinstance(self.network, vin.ValueIteration)
        moves = self.slots.roles(masks).moves
        cells = masks.shape[2] // slots.CELL
        agent = torch.einsum("nk,nkc->nc", moves.softmax(1), slots.places_of(masks))
        seen = on_grid(masks, slots.CELL)
        return self.network.attend(seen, agent.unflatten(1, (cells, cells))), moves


class Cloning(mapper.Method):
    """Behavioural cloning in the mapper's pictures."""

    policy: OnSlots  # type: ignore[assignment]

    def __init__(self, problem: Problem, settings: Settings) -> None:
        """Draw the weights."""
        super().__init__(problem, settings)
        self.policy = OnSlots(problem.spec, settings)
        self.optimizer = self.adam(self.policy)

    @cached_property
    def seen(self) -> list[slots.Slots]:
        """The slots of the pictures of all states."""
        return super().look(np.arange(len(self.problem.arrays.labyrinth)))

    def look(self, states: NDArray[np.int64]) -> list[slots.Slots]:
        return [self.seen[state] for state in states.tolist()]

    def epoch(self) -> dict[str, float]:
        self.policy.train()
        batches = self.batches(len(self.problem.demonstrations.states))
        return {"loss": float(np.mean([self.learn(batch) for batch in batches]))}

    def learn(self, batch: NDArray[np.int64]) -> float:  # type: ignore[override]
        """Take a gradient step; return the loss.

        With `explore`, as many steps are drawn from all that are known, to predict their outcomes.
        """
        steps, count = self.problem.demonstrations, len(batch)
        known = self.problem.rng.integers(len(self.states), size=count * self.settings.explore)
        masks, movers = self.draw(np.concatenate([steps.states[batch], self.states[known]]), 0)
        outputs, moves = self.policy.read(masks)
        actions = self.tensor(steps.actions[batch])
        loss = functional.cross_entropy(outputs[:count, :ACTIONS], actions)
        if moves is not None:
            loss = loss + functional.cross_entropy(moves, movers)
        if self.settings.explore:
            outcomes = outputs[count:, ACTIONS:].unflatten(1, (ACTIONS, -1))
            outcomes = outcomes[range(count), self.actions[known]]
            loss = loss + functional.cross_entropy(outcomes, self.tensor(self.outcomes[known]))
        self.descend(self.optimizer, loss)
        return loss.item()

    def descend(self, optimizer: Adam, loss: Tensor) -> None:
        optimizer.zero_grad()
        loss.backward()
        if self.settings.network == "vin":  # As methods/vin.py does.
            clip_grad_norm_(self.policy.parameters(), MAX_GRADIENT)
        optimizer.step()


class SlotDrawing(Drawing):
    """What a policy on slots is shown of labyrinths."""

    def look(self, views: Sequence[tuple[Labyrinth, State]]) -> NDArray[Any]:
        """Return which slots each block shows in the pictures of states, as `scene_of` does."""
        shape = views[0][0].structure.height, views[0][0].structure.width
        pictures = (super(SlotDrawing, self).look([view])[0] for view in views)
        return np.stack([slots.scene_of(slots.slots_of(each), *shape) for each in pictures])


def shown_as_slots(
    labyrinths: Sequence[Labyrinth], styles: Sequence[Style | None], moved: int = 0
) -> LabyrinthArrays:
    """Return labyrinths in a style each, moved by some pixels, as arrays of slots."""
    return as_arrays(labyrinths, SlotDrawing(labyrinths, styles, moved, PICTURE_SIZE))  # type: ignore[arg-type]


def main() -> None:
    """Do the runs whose files are missing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--data-dir", required=True, help="folder with the dataset of 5x5")
    parser.add_argument("--results", type=Path, required=True, help="folder for the files")
    given = parser.parse_args()
    torch.set_num_threads(1)
    for seed, variant in product(given.seeds, given.variants):
        kept = given.results / f"{variant}-seed{seed}.json"
        if not kept.exists():
            about, player = train(variant, seed, given.data_dir)
            write_results(kept, about, test(player, given.data_dir))


def settings_of(variant: str) -> Settings:
    """Return the settings of a variant."""
    own = VARIANTS[variant]
    usual = asdict(mapper.Settings()) | USUAL | AS_ON_PICTURES[own["network"]]
    return Settings(**{**usual, **own})


def train(variant: str, seed: int, data_dir: str) -> tuple[dict[str, Any], Player]:
    """Return the description of a run, and its policy."""
    settings = settings_of(variant)
    asked: dict[str, Any] = {"stages": ["train"], "size": "5", "data_dir": data_dir, "seed": seed}
    run = resolve(RunConfig(**asked, method={"name": "mapper"}))
    torch.manual_seed(seed)
    learner, _ = prepare(run, Cloning, settings, torch.device("cpu"))
    validation = load_arrays(data_dir, CONFIG, "validation", observation="vector").labyrinths
    arrays = shown_as_slots(validation, [None] * len(validation))
    arrays = replace(arrays, observations=arrays.observations[np.arange(len(arrays.labyrinth))])

    def judge(policy: Policy) -> dict[str, float]:
        return {"validation_sr": success_rate(policy, arrays)}

    def report(done: Progress) -> None:
        if "validation_sr" in done.history[-1]:
            print(f"{variant}, seed {seed}: {done.history[-1]}", flush=True)

    protocol = replace(PROTOCOLS["default"], patience=PATIENCE)
    done = fit(learner, judge, protocol, Path("no checkpoint"), {}, report, inf)
    learner.policy.load_state_dict(done.weights)
    about = {
        "run": {**identify(run, settings), "method": variant, "encoder": settings.network},
        "drawn_with_seed": SEED,
        "epochs": done.epoch,
        "selected": done.best,
        "seconds_of_training": round(done.seconds, 3),
    }
    return about, Player.of(NetworkPolicy(learner.policy), seed)


def test(player: Player, data_dir: str) -> dict[str, list[bool]]:
    """Return which labyrinths of each set a policy solves."""
    sets = labyrinth_sets(data_dir, CONFIG, sides=[10])
    solved = {}
    for name, labyrinths, styles, moved in shown(sets, TESTED_LOOKS, [MOVED]):
        if name not in UNTESTED:
            solved[name] = solved_in(player, shown_as_slots(labyrinths, styles, moved)).tolist()
            print(f"  {name}: {np.mean(solved[name]):.0%}", flush=True)
    return solved


if __name__ == "__main__":
    main()
