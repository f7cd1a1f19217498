"""The mapper: learns what moves, what actions do and where demonstrations end, and plans.

Its network is in `labyrinth_core.learning.networks.mapping`, which also says what it is given.

Like BCO (Torabi et al. 2018), the mapper learns what actions do from transitions (s, a, s') of a
random policy, and also of the demonstrations; unlike BCO, it learns a forward model. Like universal
planning networks (Srinivas et al. 2018) and value iteration networks (Tamar et al. 2016), it acts
by planning with what it has learnt. A slot is the pixels of one colour. All labels come from the
pictures of the splits `train` and `random`:

- What moves: the only slot whose cells differ between s and s' (`moving_colour`).
- Where a demonstration ends: the cell of that slot in the last picture, which the network learns to
  find as the place of a slot in the *first* picture.
- Where an action leads: the cell of that slot in s', relative to its cell in s.

Pictures are drawn as in the column `obs`, 600 pixels wide, and shifted by a few pixels. Then slots
grow over each other, in random order, as long as no slot vanishes anywhere. First pictures are
shown once more with slots that grow further, as long as no slot vanishes everywhere. Walls may
close or disappear in them, so they teach only what the slots are, and nothing about steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from labyrinth_core.evaluation import PolicyError
from labyrinth_core.learning.learner import Acting, BaseSettings, Learner, setting
from labyrinth_core.learning.networks.acting import NetworkPolicy, make_network
from labyrinth_core.learning.networks.mapping import AROUND, Mapper, MapperPolicy
from labyrinth_core.learning.networks.slots import (
    Scene,
    Slots,
    Surroundings,
    masks_of,
    places_of,
)
from labyrinth_core.learning.problem import Problem, Steps
from labyrinth_core.learning.spec import MapperSpec, NetworkSpec
from labyrinth_core.pictures import PICTURE_SIZE, ObservationSpec
from labyrinth_core.world import Task


@dataclass(frozen=True)
class Settings(MapperSpec, BaseSettings):
    """An epoch is one pass over the demonstrations; `batch_size` counts demonstrations."""

    epochs: int = 40
    evaluate_every: int = 40
    batch_size: int = 8
    learning_rate: float = 0.005
    channels: int = 32
    looks: int = 4
    steps: int = setting(
        32, "number of its labyrinth's transitions that a picture teaches", at_least=1
    )
    explore: bool = setting(True, "whether it learns from the split random as well")
    shift: int = setting(6, "maximum shift of pictures in pixels", at_least=0, at_most=60)
    grow: int = setting(
        14, "maximum growth of a colour over others in pixels", at_least=0, at_most=60
    )
    overgrow: int = setting(
        24,
        "maximum growth of a colour, in pixels, in pictures that teach nothing about steps",
        at_least=0,
        at_most=60,
    )


class Method(Learner):
    """The network, and the labels read from the pictures."""

    policy: Mapper

    def __init__(self, problem: Problem, settings: Settings) -> None:
        super().__init__(problem, settings)
        arrays = problem.arrays
        steps = [problem.demonstrations, *([problem.exploration()] if settings.explore else [])]
        states, actions, after = map(np.concatenate, zip(*steps, strict=True))
        order = arrays.labyrinth[states].argsort(kind="stable")
        self.states, self.actions, after = states[order], actions[order], after[order]
        numbers = np.arange(len(arrays.labyrinths) + 1)
        self.bounds = arrays.labyrinth[self.states].searchsorted(numbers)
        self.colours, self.cells = self.moving(problem.demonstrations)
        there, here = (np.divmod(self.cells[each], self.size[1]) for each in (after, self.states))
        moves = np.stack(there, axis=1) - np.stack(here, axis=1)
        known = np.array([*AROUND, (0, 0)])
        self.outcomes = (moves[:, None] == known).all(axis=2).argmax(axis=1)
        lasts = np.cumsum([len(route) for route in arrays.routes]) - 1
        self.first = arrays.route_starts
        self.ends = self.cells[problem.demonstrations.next_states[lasts]]
        self.done = 0  # Epochs.

    @property
    def size(self) -> tuple[int, int]:
        """The number of rows and of columns of the labyrinths."""
        return self.problem.spec.height, self.problem.spec.width

    @classmethod
    def make(cls, spec: NetworkSpec, settings: Any) -> nn.Module:
        if spec.task != Task.NAVIGATION:
            raise PolicyError(f"task={spec.task}: method=mapper supports only task=navigation")
        return make_network(spec, own=settings)

    @classmethod
    def image_size(cls, spec: NetworkSpec, settings: Any, height: int, width: int) -> int:  # noqa: ARG003
        """Return the size of the pictures in datasets, in which each object has a flat colour."""
        return PICTURE_SIZE

    @classmethod
    def player(cls, policy: Acting, spec: NetworkSpec, settings: Any) -> MapperPolicy:  # noqa: ARG003
        """Return a policy that plans with the network, and remembers its plan."""
        assert isinstance(policy, NetworkPolicy)
        assert isinstance(policy.network, Mapper)
        return MapperPolicy(policy.network, spec.height, spec.width)

    def moving(self, shown: Steps) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the colour that moves in each labyrinth, and its cell in each state.

        The colour is read from the labyrinth's demonstration. The pictures of one labyrinth are
        drawn at a time, since slots take 10 kB per state.
        """
        labyrinth = self.problem.arrays.labyrinth
        numbers = np.arange(len(self.problem.arrays.labyrinths) + 1)
        order = labyrinth[shown.states].argsort(kind="stable")
        pairs = np.stack([shown.states[order], shown.next_states[order]], axis=1)
        steps = labyrinth[pairs[:, 0]].searchsorted(numbers)
        states = labyrinth.searchsorted(numbers)
        colours, cells = [], []
        for number in numbers[:-1]:
            first, end = states[number : number + 2]
            seen = self.look(np.arange(first, end))
            own = pairs[steps[number] : steps[number + 1]] - first
            moved = (moving_colour([seen[each] for each in pair], *self.size) for pair in own)
            colours.append(next(colour for colour in moved if colour is not None))
            cells += [each.cell_of(colours[-1], *self.size) for each in seen]
        return np.array(colours), np.array(cells)

    def look(self, states: NDArray[np.int64]) -> list[Slots]:
        """Return the slots of the pictures of states."""
        arrays = self.problem.arrays
        spec = ObservationSpec("image", PICTURE_SIZE, draw=True)
        slots = []
        for state in states.tolist():
            labyrinth = arrays.labyrinths[arrays.labyrinth[state]]
            view = (labyrinth, labyrinth.state_at(int(arrays.state[state])))
            slots.append(Slots.of(spec.look([view])[0]))
        return slots

    def draw(self, states: NDArray[np.int64], overgrown: int) -> tuple[Tensor, Tensor]:
        """Return varied pictures of states as masks, and the number of the slot that moves in each.

        Args:
            states: The states to draw.
            overgrown: The first N pictures get slots that grow further (`overgrow`).
        """
        colours = self.colours[self.problem.arrays.labyrinth[states]]
        slots = self.look(states)
        scenes = [self.vary(each, number < overgrown) for number, each in enumerate(slots)]
        movers = [
            int(np.flatnonzero(each.colours == colour)[0])
            for each, colour in zip(slots, colours, strict=True)
        ]
        return masks_of(np.stack(scenes)).to(self.problem.device), self.tensor(np.array(movers))

    def vary(self, slots: Slots, overgrown: bool) -> Scene:
        """Shift a picture by a few pixels, grow its slots one after the other, and return it."""
        settings, rng = self.settings, self.problem.rng
        most = settings.overgrow if overgrown else settings.grow

        def shown(slots: Slots) -> Scene:
            """Return the slots in the middle, at each side and corner of cells, or anywhere."""
            scene = slots.scene(*self.size, 4)
            for axis, count in enumerate(scene.shape):
                starts = [0] if overgrown else [0, *range(1, count, 2)]
                scene = np.bitwise_or.reduceat(scene, starts, axis)
            return scene

        down, right = rng.integers(-settings.shift, settings.shift, 2, endpoint=True).tolist()
        slots = slots.shifted(down, right)
        before = shown(slots)
        for slot in rng.permutation(len(slots.colours)).tolist():
            larger = slots.grown(slot, int(rng.integers(most, endpoint=True)))
            after = shown(larger)
            if not (before & ~after).any():
                slots, before = larger, after
        return slots.scene(*self.size)

    def epoch(self) -> dict[str, float]:
        self.policy.train()
        # The rate falls to 0: with a constant rate, the outcome depends on the seed.
        share = (1 + math.cos(math.pi * self.done / self.settings.epochs)) / 2
        self.optimizer.param_groups[0]["lr"] = self.settings.learning_rate * share
        self.done += 1
        batches = self.batches(len(self.first))
        moves, ends, does = torch.stack([self.learn(batch) for batch in batches]).mean(0).tolist()
        return {"loss": moves + ends + does, "moves": moves, "ends": ends, "does": does}

    def learn(self, episodes: NDArray[np.int64]) -> Tensor:
        """Take a gradient step; return the three losses.

        A batch has three pictures of each demonstration's labyrinth: the first picture overgrown,
        the first picture, and a picture of any known state. Where demonstrations end is learnt
        from the first two, what moves from all three, and what steps do from the last two. Steps
        may begin in any cell, as if the agent were there.
        """
        count, first = len(episodes), self.first[episodes]
        labyrinths = self.problem.arrays.labyrinth[first]
        others = self.states[self.some_steps(labyrinths, 1)[:, 0]]
        masks, movers = self.draw(np.concatenate([first, first, others]), count)
        roles = self.policy.roles(masks)
        moves = functional.cross_entropy(roles.moves, movers)
        cells = np.tile(self.ends[episodes], 2)
        places = places_of(masks)[range(2 * count), :, cells]
        ends = -(roles.ends[: 2 * count].log_softmax(1) + places.log()).logsumexp(1).mean()
        steps = self.some_steps(np.tile(labyrinths, 2), self.settings.steps)
        pictures = torch.arange(len(steps)).repeat_interleave(steps.shape[1])
        steps = steps.reshape(-1)
        around = Surroundings.of(masks[count:], movers[count:])
        passable = self.policy.passable(around.on_ways(roles.looks[count:], AROUND))
        outcomes = self.policy.outcomes(passable[pictures, self.cells[self.states[steps]]])
        does = -outcomes[range(len(steps)), self.actions[steps], self.outcomes[steps]].mean()
        self.descend(self.optimizer, moves + ends + does)
        return torch.stack([moves, ends, does]).detach()

    def some_steps(self, labyrinths: NDArray[np.int64], count: int) -> NDArray[np.int64]:
        """Return the numbers of random known steps in labyrinths, shape (labyrinths, count)."""
        low, high = self.bounds[labyrinths, None], self.bounds[labyrinths + 1, None]
        return self.problem.rng.integers(low, high, (len(labyrinths), count))


def moving_colour(pictures: Sequence[Slots], height: int, width: int) -> int | None:
    """Return the colour of the only slot that a step moves; None if it moves no or several slots.

    Args:
        pictures: The pictures before and after the step.
        height: The number of rows.
        width: The number of columns.
    """
    places = []
    for slots in pictures:
        cells = slots.scene(height, width, 1)
        numbers = enumerate(slots.colours.tolist())
        places.append({colour: (cells >> number & 1).tobytes() for number, colour in numbers})
    before, after = places
    moved = [int(colour) for colour in before if before[colour] != after.get(colour)]
    return moved[0] if len(moved) == 1 else None
