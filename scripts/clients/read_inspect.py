"""inspect-ai: run the tasks of a release's eval.yaml, and the task of examples/language_model.py.

A mock model answers, so that the correct scores are known.
"""

from __future__ import annotations

import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import inspect_ai
from comparing import CONFIG, FOLDER, report
from datasets import load_dataset
from inspect_ai.model import Model, ModelOutput, ModelUsage, get_model

from labyrinth_core import Action, parse

RELEASE, EXAMPLE = "user/labyrinth", Path(__file__).parents[2] / "examples" / "language_model.py"
rows = load_dataset(RELEASE, f"{CONFIG}-questions").remove_columns(["image", "image_300"])
questions = [row for split in rows.values() for row in split]


def answering(answer: Callable[[dict[str, Any]], str]) -> Model:
    """Return a mock model that answers each question with a function of its row."""

    def reply(messages: list[Any], *_: object) -> ModelOutput:
        (message,) = messages
        pictures = [part.image for part in message.content if hasattr(part, "image")]
        (row,) = (
            each
            for each in questions
            if (each["image_url"] in pictures if pictures else each["prompt"] in message.text)
        )
        output = ModelOutput.from_content("mockllm/model", answer(row))
        output.usage = ModelUsage()  # Otherwise counting tokens would download a file.
        return output

    return get_model("mockllm/model", custom_outputs=reply)


def figures(tasks: Any, answer: Callable[[dict[str, Any]], str]) -> list[dict[str, float]]:
    """Return the metrics of each task, without standard errors, for a model with these answers."""
    logs = inspect_ai.eval(tasks, model=answering(answer), display="none", log_dir=f"{FOLDER}/logs")
    assert all(log.status == "success" for log in logs), [log.error for log in logs]
    return [
        {
            f"{score.name} {name}": metric.value
            for score in log.results.scores
            for name, metric in score.metrics.items()
            if name != "stderr"
        }
        for log in logs
    ]


def with_one_error(row: dict[str, Any]) -> str:
    """Return a shortest route with a move into the first wall beside it."""
    labyrinth, route = parse(row["info"]), row["routes"][0].upper().split()
    cell, place = labyrinth.start, 0
    while cell not in (beside := labyrinth.structure.moves[cell]):
        cell, place = beside[Action[route[place]]], place + 1
    route.insert(place, Action(beside.index(cell)).name)
    return f"ANSWER: {' '.join(route)}"


tasks = figures(f"hf/{RELEASE}", lambda row: f"So it is:\n**ANSWER: {row['answer'].upper()}**")
assert len(tasks) == 2 * len(rows), tasks
assert all(set(task.values()) == {1} for task in tasks), tasks
for wrong in (lambda _: "", with_one_error):
    assert all(set(task.values()) == {0} for task in figures(f"hf/{RELEASE}", wrong))

labyrinths = runpy.run_path(str(EXAMPLE))["labyrinths"]
for picture in (False, True):
    task = labyrinths(RELEASE, CONFIG, picture=picture)
    for share, answer in {
        1: lambda row: f"Up? No.\nANSWER: {row['routes'][-1]}",
        0: lambda _: "",
    }.items():
        (found,) = figures(task, answer)
        assert {name.split("grouped_")[1] for name in found} == {*rows, "all"}
        assert set(found.values()) == {share}, found
    (found,) = figures(task, with_one_error)
    assert set(found.values()) == {0}, found

report(
    ["inspect-ai", "datasets"],
    f"{len(tasks)} tasks of a release's eval.yaml and the recipe's, text and picture, "
    f"{len(questions):,} questions: right answers score 1, silence and routes with an error 0",
)
