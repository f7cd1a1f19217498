"""Score a written route: read the moves from an answer and replay them.

All shortest routes score the same, since an answer is not compared with a reference answer.
"""

from __future__ import annotations

import re
from bisect import bisect
from dataclasses import dataclass

from labyrinth_core.language import parse
from labyrinth_core.world import Action, Labyrinth, Solver, State

_MARK = re.compile(r"answer[\s*_]{0,9}:", re.IGNORECASE)
_WORD = re.compile(r"[^\W\d_]+")
_MOVES = {action.name.lower(): action for action in Action} | {a.name[0]: a for a in Action}
"""A lower-case word, or a capital letter -> the move."""
_BETWEEN = ("and", "then")


@dataclass(frozen=True)
class RouteScore:
    """The score of an answer in a labyrinth."""

    moves: tuple[Action, ...]
    """The moves that were read from the answer."""
    optimum: int
    """The number of moves of a shortest route."""
    steps: int | None
    """The number of moves up to the goal; None if the goal is not reached."""
    illegal_move: int | None
    """The index in `moves` of the first move that is not allowed; None if all are allowed."""
    reason: str | None
    """Why the attempt failed: `wall`, `door` (without the key), `ice`, `after the goal` or `limit`
    (of 40 moves per cell) for an illegal move, else `no moves` or `short of the goal`; None if it
    did not fail."""

    @property
    def reaches_goal(self) -> bool:
        """Whether the moves before the first illegal one reach the goal."""
        return self.steps is not None

    @property
    def extra_moves(self) -> int | None:
        """The number of moves above the optimum; None if the goal is not reached."""
        return None if self.steps is None else self.steps - self.optimum

    @property
    def is_shortest(self) -> bool:
        """Whether the answer is a shortest route, any of them, with no further moves."""
        return self.extra_moves == 0 and self.reason is None


def score_answer(labyrinth: Labyrinth | str, answer: str | None) -> RouteScore:
    """Return the score of an answer in words, replayed move by move.

    The attempt ends at the first move that is not allowed: into a wall or a closed door, onto ice,
    after the goal, or beyond 40 moves per cell. In the environment, bumping into a wall only costs
    a step; if it did here, too, a list of random moves would often reach the goal. The time is
    proportional to the length of the answer, about a second per megabyte.

    Args:
        labyrinth: The labyrinth, or its text, such as from the column `info`. The moves begin on
            the start.
        answer: The text of the answer; see `read_moves`. None, the content of an empty reply from
            some language models, has no moves.

    Raises:
        LabyrinthSyntaxError: The text does not describe a labyrinth.
    """
    if isinstance(labyrinth, str):
        labyrinth = parse(labyrinth)
    moves, optimum = read_moves(answer or ""), Solver(labyrinth).moves
    state, limit = labyrinth.initial, labyrinth.step_limit
    steps = reason = None
    for number, move in enumerate(moves):
        if steps is not None:
            reason = "after the goal"
        else:
            reason = "limit" if number == limit else _why_not(labyrinth, state, move)
        if reason is not None:
            return RouteScore(moves, optimum, steps, number, reason)
        state = labyrinth.transition(state, move)
        if state.agent == labyrinth.goal:
            steps = number + 1
    if steps is None:
        reason = "short of the goal" if moves else "no moves"
    return RouteScore(moves, optimum, steps, None, reason)


def _why_not(labyrinth: Labyrinth, state: State, move: Action) -> str | None:
    """Return why a move is not allowed in a state; None if it is allowed."""
    beside = labyrinth.structure.moves[state.agent][move]
    if beside == state.agent:
        return "wall"
    if beside in labyrinth.ice:
        return "ice"
    return labyrinth.task.rules.barrier if labyrinth.transition(state, move) == state else None


def read_moves(answer: str) -> tuple[Action, ...]:
    """Return the moves of an answer; an empty tuple if it has no moves.

    A move is one of the words up, right, down and left in any case, or one of the capital letters
    U, R, D and L. A run is a sequence of moves with no words between them but "and" and "then";
    punctuation and digits are ignored. The last "Answer:" that has a move somewhere after it
    counts: the longest run on its line, or, if its line has no move, the longest run after it; the
    first of equally long runs. Without any "Answer:" the last run of the text counts.
    """
    marks = [mark.end() for mark in _MARK.finditer(answer)]
    if not marks:
        return (_runs(answer) or [()])[-1]
    moves = (word.start() for word in _WORD.finditer(answer) if _move(word[0]) is not None)
    last_move = max(moves, default=-1)
    followed = bisect(marks, last_move)
    if not followed:
        return ()
    after = answer[marks[followed - 1] :]
    line = re.split(r"[\r\n]", after, maxsplit=1)[0]
    return max(_runs(line) or _runs(after), key=len)


def _move(word: str) -> Action | None:
    """Return the move that a word means, or None."""
    return _MOVES.get(word if len(word) == 1 else word.lower())


def _runs(text: str) -> list[tuple[Action, ...]]:
    """Return the runs of moves in a text, in order."""
    runs: list[list[Action]] = [[]]
    for word in _WORD.finditer(text):
        move = _move(word[0])
        if move is not None:
            runs[-1].append(move)
        elif runs[-1] and word[0].lower() not in _BETWEEN:
            runs.append([])
    return [tuple(run) for run in runs if run]
