"""Check that the outcomes in a results file are possible, and that its figures follow from them.

The file may come from anyone, so nothing in it is used before it is checked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.description import MOST_EPISODES
from labyrinth_core.evaluation.playing import Episodes
from labyrinth_core.evaluation.scores import ACCURACIES, Scores
from labyrinth_core.language.source_text import parse_size
from labyrinth_core.world.labyrinth import Task

_EXACT = 1e-12
"""Figures that differ by no more than this are equal; another processor may round the last of their
sixteen digits differently."""

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Rules:
    """The rules that all episodes of an evaluation obey."""

    cells: int
    """The number of cells of a labyrinth."""
    task: Task
    looks_up: bool
    """Whether the policy remembers nothing: an episode that revisits a state never ends."""
    episodes: int
    """The number of episodes in each labyrinth."""

    @classmethod
    def of(cls, config: str, way: str, episodes: int) -> Rules:
        """Return the rules for a config such as `5x5-icy_floor`; ValueError for another name."""
        size, _, task = config.partition("-")
        height, width = parse_size(size)
        if size != f"{height}x{width}" or task not in ("", *map(str, Task)) or task == "navigation":
            raise ValueError(f"config={config}: there is no such config")
        if way == "look-ups" and episodes != 1:
            raise ValueError(f"episodes={episodes}: look-ups give one episode in each labyrinth")
        if episodes > MOST_EPISODES:
            raise ValueError(
                f"episodes={episodes}: at most {MOST_EPISODES:,} in each labyrinth are allowed"
            )
        return cls(height * width, Task(task or "navigation"), way == "look-ups", episodes)

    @property
    def states(self) -> int:
        """The largest number of states of a labyrinth: without the key, with it, and door open."""
        return self.cells * (3 if self.task is Task.KEY_AND_DOOR else 1)


def scores_of(split: str, content: Mapping[str, Any], rules: Rules) -> Scores:
    """Return the scores that follow from the outcomes of a split in a file.

    Args:
        split: The name of the split.
        content: The split's part of the file, of the right shape.
        rules: The rules of its episodes.

    Raises:
        ValueError: An outcome is impossible, or a figure does not follow; the message names it.
    """
    refuse(split, _miscounted(content, rules.episodes))
    episodes = Episodes.of_letters(content["outcomes"], content["moves"], rules.cells)
    scores = Scores(
        episodes,
        np.array([int(each, 16) for each in content["labyrinth_ids"]], np.int64),
        np.array(content["distance"], np.int64),
        content["accuracy_on_demonstrations"],
        content["accuracy_elsewhere"],
        known_route=np.array([mark == "1" for mark in content["known_route"]]),
    )
    refuse(split, _impossible(content, scores, rules))
    refuse(split, _other_figures(content, scores))
    return scores


def refuse(split: str, problems: Iterator[str]) -> None:
    """Raise ValueError for the first problem, if any."""
    problem = next(problems, None)
    if problem is not None:
        raise ValueError(f"{split}: {problem}")


def _miscounted(content: Mapping[str, Any], episodes: int) -> Iterator[str]:
    """Yield each list of the wrong length, and a duplicate labyrinth."""
    ids = content["labyrinth_ids"]
    for name in ("outcomes", "moves"):
        if len(content[name]) != episodes:
            yield f"{name} are of {len(content[name])} episodes in each labyrinth, not {episodes}"
    parts = [(name, content[name]) for name in ("labyrinth_ids", "distance", "known_route")]
    parts += [(name, each) for name in ("outcomes", "moves") for each in content[name]]
    for name, part in parts:
        if len(part) != content["labyrinths"]:
            yield f"{name} are of {len(part)} labyrinths, not {content['labyrinths']}"
    if len(set(ids)) < len(ids):
        twice, _ = Counter(ids).most_common(1)[0]
        yield f"labyrinth {twice} is listed twice"


def _impossible(content: Mapping[str, Any], scores: Scores, rules: Rules) -> Iterator[str]:
    """Yield each outcome that is impossible for any policy."""
    episodes, distance = scores.episodes, scores.distance
    limit, moves, solved = episodes.step_limit, episodes.moves, episodes.solved
    if content["step_limit"] != limit:
        yield f"step_limit is {content['step_limit']}, not {limit}"
    iced = episodes.outcomes == "ice"
    ended, most = solved | iced, rules.states - 1
    for name in ACCURACIES:
        if content[name] is not None and not rules.looks_up:
            yield f"{name} is {content[name]}, which only look-ups can give"
    detour = moves - distance
    cases: list[tuple[Bools, str]] = [
        (np.broadcast_to(distance > most, moves.shape), f"a shortest route of more than {most}"),
        (moves > limit, f"more moves than the limit of {limit}"),
        (solved & (moves < distance), "a solution of fewer moves than a shortest route"),
        (~ended & (moves != limit), f"a failure before the limit of {limit} moves"),
        (iced & (rules.task is not Task.ICY_FLOOR), "an end on ice, which this task does not have"),
        (ended & (moves > most) & rules.looks_up, f"more than {most} moves to an end by look-ups"),
        (solved & (detour % 2 == 1) & rules.looks_up, "a detour of an odd number of moves"),
    ]
    yield from cases_of(scores, cases)


def cases_of(scores: Scores, cases: Iterable[tuple[Bools, str]]) -> Iterator[str]:
    """Yield a message for each impossible case that occurs, about its first episode.

    Args:
        scores: The scores.
        cases: Masks of the episodes, shape (E, L), and what is impossible about them.
    """
    episodes = scores.episodes
    for wrong, what in cases:
        for episode, labyrinth in np.argwhere(wrong)[:1].tolist():
            of = f"episode {episode + 1}, " if len(episodes.moves) > 1 else ""
            name, outcome, moves, distance = (
                f"{scores.labyrinth_ids[labyrinth]:016x}",
                episodes.outcomes[episode, labyrinth],
                episodes.moves[episode, labyrinth],
                scores.distance[labyrinth],
            )
            yield (
                f"{of}labyrinth {name} has {what}: {outcome} after {moves} moves, with a shortest "
                f"route of {distance}"
            )


def _other_figures(content: Mapping[str, Any], scores: Scores) -> Iterator[str]:
    """Yield each figure that does not follow from the outcomes."""
    for name, right in scores.figures().items():
        if not _equal(content[name], right):
            yield f"{name} is {content[name]!r:.60}, but {right} follows from the outcomes"


def _equal(one: Any, other: Any) -> bool:
    if isinstance(other, list):
        same = isinstance(one, list) and len(one) == len(other)
        return same and all(_equal(*pair) for pair in zip(one, other, strict=True))
    if type(one) in (int, float) and type(other) in (int, float):
        return bool(-1e15 < one < 1e15 and abs(one - other) <= _EXACT)
    return type(one) is type(other) and bool(one == other)
