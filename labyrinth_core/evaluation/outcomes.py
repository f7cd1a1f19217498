"""Whether the outcomes in a file of results are possible, and whether its figures follow from them.

A file may come from anyone, so that nothing in it is used before it was checked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.labyrinth_table import TABLE, table_rows
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.source import locate
from labyrinth_core.evaluation.playing import Episodes
from labyrinth_core.evaluation.scores import Scores
from labyrinth_core.world.grid import parse_size
from labyrinth_core.world.labyrinth import Task

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


@dataclass(frozen=True, eq=False)
class KnownDataset:
    """The labyrinths of a dataset, with which results are compared."""

    place: str
    """Folder, or id on the Hub, and the config."""
    fingerprint: str
    splits: Mapping[str, Mapping[str, int]]
    """Split -> labyrinth id -> moves on a shortest route, in the order of the dataset."""

    @classmethod
    def read(cls, source: str, config: str, revision: str | None = None) -> KnownDataset:
        """Return the labyrinths of a dataset in a folder or on the Hub.

        Raises:
            ValueError: A folder is given with a revision.
            DatasetError: There is no such dataset.
        """
        folder = locate(source, config, [TABLE], revision)
        manifest = Manifest.read(folder)
        splits: dict[str, dict[str, int]] = {}
        for row in table_rows(folder, manifest):
            splits.setdefault(row["split"], {})[row["labyrinth_id"]] = row["moves"]
        return cls(f"{source}/{config}", manifest.fingerprint, splits)

    def compare(
        self, fingerprint: str, scores: Mapping[str, Scores], counts: Mapping[str, int]
    ) -> None:
        """Check that scores are of these labyrinths, in their order.

        Args:
            fingerprint: The fingerprint of the dataset that they are said to be of.
            scores: The scores by split.
            counts: The number of labyrinths, the first ones, for each split of which not all
                labyrinths were evaluated.

        Raises:
            ValueError: They are not; the message says where.
        """
        if fingerprint != self.fingerprint:
            raise ValueError(
                f"it is of another dataset than {self.place}: their fingerprints are "
                f"{fingerprint:.16} and {self.fingerprint:.16} (dataset= names another one)"
            )
        for split, found in scores.items():
            refuse(split, self._other_labyrinths(split, found, counts.get(split)))

    def _other_labyrinths(self, split: str, scores: Scores, count: int | None) -> Iterator[str]:
        """Yield what differs from the labyrinths of the dataset."""
        if split not in self.splits:
            yield f"{self.place} has no such split"
            return
        right = list(self.splits[split].items())[:count]
        if len(scores.distance) != len(right):
            yield f"{len(scores.distance)} labyrinths, but {self.place} has {len(right)}"
            return
        for place, (name, moves) in enumerate(right):
            found = f"{scores.labyrinth_ids[place]:016x}"
            if found != name:
                yield f"labyrinth {place + 1} is {found}, but {name} in {self.place}"
            elif scores.distance[place] != moves:
                yield (
                    f"labyrinth {name} has a shortest route of {scores.distance[place]} moves, but "
                    f"of {moves} in {self.place}"
                )


def scores_of(split: str, told: Mapping[str, Any], rules: Rules) -> Scores:
    """Return the scores that follow from the outcomes that a file tells of a split.

    Args:
        split: The name of the split.
        told: What the file says of it, of the right shape.
        rules: What holds for its episodes.

    Raises:
        ValueError: Something is impossible, or a figure does not follow; the message says what.
    """
    refuse(split, _miscounted(told, rules.episodes))
    episodes = Episodes.of_letters(told["outcomes"], told["moves"], rules.cells)
    marks = told["known_route"]
    scores = Scores(
        episodes,
        np.array([int(each, 16) for each in told["labyrinth_ids"]], np.int64),
        np.array(told["distance"], np.int64),
        told["accuracy_on_demonstrations"],
        told["accuracy_elsewhere"],
        known_route=None if marks is None else np.array([mark == "1" for mark in marks]),
    )
    refuse(split, _impossible(told, scores, rules))
    refuse(split, _other_figures(told, scores))
    return scores


def refuse(split: str, problems: Iterator[str]) -> None:
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
        if not _equal(told[name], right):
            yield f"{name} is {told[name]!r:.60}, but {right} follows from the outcomes"


def _equal(one: Any, other: Any) -> bool:
    if isinstance(other, list):
        same = isinstance(one, list) and len(one) == len(other)
        return same and all(_equal(*pair) for pair in zip(one, other, strict=True))
    if type(one) in (int, float) and type(other) in (int, float):
        return bool(-1e15 < one < 1e15 and abs(one - other) <= _EXACT)
    return type(one) is type(other) and bool(one == other)
