"""Whether the outcomes that a file tells can be, and whether its figures follow from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.following import Episodes
from labyrinth_core.evaluation.scores import Scores, episodes_of
from labyrinth_core.world.grid import parse_size
from labyrinth_core.world.labyrinth import Task
from pipeline.studies.results.known import KnownDataset

_EXACT = 1e-12
"""The largest difference of two figures that are the same; another processor may round the last of
their sixteen digits differently."""

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Rules:
    """What holds for the episodes of an evaluation."""

    cells: int
    """The number of cells of a labyrinth."""
    task: Task
    looks_up: bool
    """Whether the policy remembers nothing: an episode that comes to a state twice never ends."""
    episodes: int
    """The number of episodes in each labyrinth."""

    @classmethod
    def of(cls, config: str, way: str, episodes: int) -> Rules:
        """Return the rules for a config such as `5x5-icy_floor`; ValueError if there is none."""
        size, _, task = config.partition("-")
        height, width = parse_size(size)
        if size != f"{height}x{width}" or task not in ("", *map(str, Task)) or task == "navigation":
            raise ValueError(f"config={config}: there is none of this name")
        if way == "look-ups" and episodes != 1:
            raise ValueError(f"episodes={episodes}: a policy has one in each labyrinth by look-ups")
        return cls(height * width, Task(task or "navigation"), way == "look-ups", episodes)

    @property
    def states(self) -> int:
        """The largest number of states of a labyrinth: without key, with it, the door open."""
        return self.cells * (3 if self.task is Task.KEY_AND_DOOR else 1)


def scores_of(
    split: str, told: Mapping[str, Any], rules: Rules, known: KnownDataset | None
) -> Scores:
    """Return the scores that follow from the outcomes that a file tells of a split.

    Args:
        split: The name of the split.
        told: What the file says of it, of the right shape.
        rules: What holds for its episodes.
        known: The dataset; None if it is not at hand.

    Raises:
        ValueError: Something is impossible, or a figure does not follow; the message says what.
    """
    _refuse(split, _miscounted(told, rules.episodes))
    if known is not None:
        _refuse(split, _other_labyrinths(split, told, known))
    rows = [
        episodes_of({"outcomes": letters, "moves": moves}, rules.cells)
        for letters, moves in zip(told["outcomes"], told["moves"], strict=True)
    ]
    outcomes, moves = (np.stack([getattr(r, name) for r in rows]) for name in ("outcomes", "moves"))
    ids = np.array([int(each, 16) for each in told["labyrinth_ids"]], np.int64)
    distance = np.array(told["distance"], np.int64)
    marks = told["known_route"]
    scores = Scores(
        Episodes(outcomes, moves, rules.cells),
        ids,
        distance,
        accuracy_on_demonstrations=None,
        accuracy_elsewhere=None,
        known_route=None if marks is None else np.array([mark == "1" for mark in marks]),
    )
    _refuse(split, _impossible(told, scores, rules))
    _refuse(split, _other_figures(told, scores))
    return scores


def _refuse(split: str, problems: Iterator[str]) -> None:
    """Raise a ValueError for the first problem, if there is one."""
    problem = next(problems, None)
    if problem is not None:
        raise ValueError(f"{split}: {problem}")


def _miscounted(told: Mapping[str, Any], episodes: int) -> Iterator[str]:
    """Yield what there is too much or too little of."""
    ids = told["labyrinth_ids"]
    for name in ("outcomes", "moves"):
        if len(told[name]) != episodes:
            yield f"{name} are of {len(told[name])} episodes in each labyrinth, not {episodes}"
    parts = [(name, told[name]) for name in ("labyrinth_ids", "distance")]
    parts += [(name, each) for name in ("outcomes", "moves") for each in told[name]]
    if told["known_route"] is not None:
        parts.append(("known_route", told["known_route"]))
    for name, part in parts:
        if len(part) != told["labyrinths"]:
            yield f"{name} are of {len(part)} labyrinths, not {told['labyrinths']}"
    if len(set(ids)) < len(ids):
        twice, _ = Counter(ids).most_common(1)[0]
        yield f"labyrinth {twice} is there twice"


def _other_labyrinths(split: str, told: Mapping[str, Any], known: KnownDataset) -> Iterator[str]:
    """Yield what differs from the labyrinths of the dataset."""
    if split not in known.splits:
        yield f"{known.place} has no such split"
        return
    there = known.splits[split]
    if told["labyrinths"] != len(there.labyrinth_ids):
        yield f"{told['labyrinths']} labyrinths, but {known.place} has {len(there.labyrinth_ids)}"
        return
    here = zip(told["labyrinth_ids"], told["distance"], strict=True)
    right = zip(there.labyrinth_ids, there.distance, strict=True)
    for number, ((name, moves), (right_name, right_moves)) in enumerate(
        zip(here, right, strict=True), start=1
    ):
        if name != right_name:
            yield f"labyrinth {number} is {name}, but {right_name} in {known.place}"
        elif moves != right_moves:
            yield (
                f"labyrinth {name} has a shortest route of {moves} moves, but of {right_moves} in "
                f"{known.place}"
            )


def _impossible(told: Mapping[str, Any], scores: Scores, rules: Rules) -> Iterator[str]:
    """Yield what cannot be, whatever the policy."""
    episodes, distance = scores.episodes, scores.distance
    limit, moves, solved = episodes.step_limit, episodes.moves, episodes.solved
    if told["step_limit"] != limit:
        yield f"step_limit is {told['step_limit']}, not {limit}"
    iced = episodes.outcomes == "ice"
    ended, most = solved | iced, rules.states - 1
    cases: list[tuple[Bools, str]] = [
        (np.broadcast_to(distance > most, moves.shape), f"a shortest route of more than {most}"),
        (moves > limit, f"more moves than the limit of {limit}"),
        (solved & (moves < distance), "a solution of fewer moves than a shortest route"),
        (~ended & (moves != limit), f"a failure before the limit of {limit} moves"),
        (iced & (rules.task is not Task.ICY_FLOOR), "an end on ice, which this task has not"),
        (ended & (moves > most) & rules.looks_up, f"more than {most} moves to an end by look-ups"),
    ]
    for wrong, what in cases:
        for episode, labyrinth in np.argwhere(wrong)[:1].tolist():
            of = f"episode {episode + 1}, " if rules.episodes > 1 else ""
            yield (
                f"{of}labyrinth {told['labyrinth_ids'][labyrinth]} has {what}: "
                f"{episodes.outcomes[episode, labyrinth]} after {moves[episode, labyrinth]} moves, "
                f"with a shortest route of {distance[labyrinth]}"
            )


def _other_figures(told: Mapping[str, Any], scores: Scores) -> Iterator[str]:
    """Yield the figures that do not follow from the outcomes."""
    for name, right in scores.figures().items():
        if not name.startswith("accuracy") and not _equal(told[name], right):
            yield f"{name} is {told[name]}, but {right} follows from the outcomes"


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, list):
        return all(map(_equal, one, other))
    if isinstance(one, float | int) and isinstance(other, float | int):
        return abs(one - other) <= _EXACT
    return bool(one == other)
