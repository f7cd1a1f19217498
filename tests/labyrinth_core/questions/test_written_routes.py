"""The moves of an answer are found in any text, and replayed as what they are."""

from __future__ import annotations

import pytest

from labyrinth_core import parse, score_answer

SETTINGS = "key_and_lock: {}\nicy_floor: {}\nocclusion: False\nlabyrinth:\n"
OPEN = (
    SETTINGS.format(False, False)
    + """\
-------------
|   |     E |
|   +   +   |
|           |
|   + - +   |
| S     |   |
-------------
end
"""
)
LOCKED = (
    SETTINGS.format(True, False)
    + """\
-------------
| K |     E |
|   + - +   |
|   |   | D |
|   + - +   |
| S         |
-------------
end
"""
)
ICY = OPEN.replace("icy_floor: False", "icy_floor: True").replace("|   |     E |", "|   | I   E |")


@pytest.mark.parametrize(
    ("answer", "moves"),
    [
        ("up right down left", "URDL"),
        ("Up, RIGHT; down -> left.", "URDL"),
        ("U R D L", "URDL"),
        ("1. up\n2. right and then down", "URD"),
        ("**Answer:** `up` | `right`", "UR"),
        ("First down? No.\nANSWER: up up\n", "UU"),
        ("Answer: left left\nWait. Answer : up\nI hope that is right.", "U"),
        ("ANSWER: My route is up up, which goes right at last.", "UU"),
        ("I go right, no: left.\n\nSo it is up, right, right", "URR"),
        ("Answer: I do not know. Before that: nothing.", ""),
        ("up right down\nAnswer:", ""),
        ("ANSWER: up up\n\nTo check the answer: both moves are legal.", "UU"),
        ("ANSWER: up up\r\nThe answer: \r\nThe answer:", "UU"),
        ("ANSWER: up right\nCheck: up, up, up and right are other moves.", "UR"),
        ("Answer: up right\nup up", "UR"),
        ("**Answer:**\n\n1. up\n2. right\nSo: right.", "UR"),
        ("upright downleft u r d l upup", ""),
        ("", ""),
    ],
)
def test_the_moves_of_an_answer_are_read(answer, moves):
    assert "".join(move.name[0] for move in score_answer(OPEN, answer).moves) == moves


@pytest.mark.parametrize(
    ("text", "answer", "steps", "illegal", "reason"),
    [
        (OPEN, "up right right up", 4, None, None),
        (OPEN, "up right up right", 4, None, None),  # Another shortest route.
        (OPEN, "up right left right right up", 6, None, None),  # A detour.
        (OPEN, "right right up", None, 1, "wall"),
        (OPEN, "up up right", None, 2, "wall"),
        (OPEN, "up right", None, None, "short of the goal"),
        (OPEN, "up right right up down", 4, 4, "after the goal"),
        (OPEN, "up down " * 181, None, 360, "limit"),
        (OPEN, "No way.", None, None, "no moves"),
        (OPEN, None, None, None, "no moves"),  # The content of a model's empty reply.
        (LOCKED, "right right up up", None, 2, "door"),
        (LOCKED, "up up down down right right up up", 8, None, None),
        (ICY, "up right up right", None, 2, "ice"),
        (ICY, "up right right up", 4, None, None),
    ],
)
def test_an_answer_is_replayed(text, answer, steps, illegal, reason):
    score = score_answer(text, answer)
    assert score == score_answer(parse(text), answer)
    assert (score.steps, score.illegal_move, score.reason) == (steps, illegal, reason)
    assert score.reaches_goal == (steps is not None)
    assert score.extra_moves == (None if steps is None else steps - score.optimum)
    assert score.is_shortest == (steps == score.optimum and reason is None)


@pytest.mark.parametrize("part", ["up ", "answer:", "answer *", "up x ", "\u2192"])
def test_a_long_answer_is_read_to_its_end(part):
    answer = part * (300_000 // len(part)) + " Answer: up right right up"
    assert len(score_answer(OPEN, answer).moves) == 4


def test_a_text_that_is_no_labyrinth_is_refused():
    with pytest.raises(ValueError, match="unknown setting"):
        score_answer("up", "up")
