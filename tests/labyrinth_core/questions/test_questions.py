"""A question shows its labyrinth as picture and as text, and knows every shortest route."""

from __future__ import annotations

import io
import json
from base64 import b64decode
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from labyrinth_core import Labyrinth, Structure, Task, parse, question, render, sample_labyrinth
from labyrinth_core import score_answer as score
from labyrinth_core.language import labyrinth_id
from labyrinth_core.questions import QUESTION_COLUMNS
from labyrinth_core.world import Look

TASKS = [task for task in Task if task is not Task.PARTIAL_OBSERVABILITY]


def opened(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)))


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("look", Look)
def test_a_question_follows_from_its_labyrinth(task, look):
    sampled = sample_labyrinth(3, 4, task, np.random.default_rng(0), open_walls=0.5)
    labyrinth = replace(sampled, look=look)
    row = question(labyrinth)
    assert list(row) == [column.name for column in QUESTION_COLUMNS]
    assert row == question(row["info"])
    assert parse(row["info"]) == labyrinth
    assert row["labyrinth_id"] == labyrinth_id(labyrinth)
    for column, size in (("image", 600), ("image_300", 300)):
        expected = render(labyrinth, labyrinth.initial, size)
        np.testing.assert_array_equal(opened(row[column]["bytes"]), expected)
    head, _, encoded = row["image_url"].partition(",")
    assert (head, b64decode(encoded)) == ("data:image/png;base64", row["image"]["bytes"])
    assert row["text"] in row["prompt"]
    assert "@" in row["text"]
    assert row["text"] not in row["picture_prompt"]
    colour = "orange" if look is Look.RECOLOURED else "green"
    assert f"agent (the {colour} square)" in row["picture_prompt"]
    assert row["answer"] == row["routes"][0]
    assert len(set(row["routes"])) == len(row["routes"])
    assert all(score(row["info"], route).is_shortest for route in row["routes"])
    assert {len(route.split()) for route in row["routes"]} == {row["moves"]}
    assert json.dumps({**row, "image": "", "image_300": ""})  # Plain values.


def test_all_seventy_routes_through_no_walls_are_listed_in_the_order_of_the_moves():
    labyrinth = Labyrinth(Structure.without_walls(5, 5), 0, 24, Task.NAVIGATION)
    routes = question(labyrinth)["routes"]
    assert len(routes) == 70
    assert routes == sorted(routes, reverse=True)  # Of these, up comes before right.


@pytest.mark.parametrize(
    ("labyrinth", "reason"),
    [
        (
            Labyrinth(Structure.without_walls(3, 3), 0, 8, Task.PARTIAL_OBSERVABILITY),
            "hidden from the agent",
        ),
        (
            Labyrinth(Structure.without_walls(8, 8), 0, 63, Task.NAVIGATION),
            r"has 3,432 shortest routes, .* 1,000 at most",
        ),
    ],
)
def test_what_makes_no_question_is_refused(labyrinth, reason):
    with pytest.raises(ValueError, match=reason):
        question(labyrinth)
