"""What card, release and validation must know of the questions beside a dataset."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from importlib.resources import files
from string import Template

import yaml

from labyrinth_core.data import DatasetConfig, Manifest
from labyrinth_core.questions import QUESTION_COLUMNS
from pipeline.inspection import Companion
from pipeline.machinery import table
from pipeline.questions.check import question_problems

NOT_ASKED = ("train", "validation", "random")
"""The splits for training and model selection, which have no questions."""
EVAL = "eval.yaml"
"""The file that registers the questions as a benchmark of inspect-ai."""


def section(questions: Mapping[str, Manifest], name: str, version: str | None) -> str:
    """Return the card's section on the questions; see `Companion.section`."""
    return Template(_read("card.md")).substitute(
        names=", ".join(f"`{config}`" for config in questions),
        columns=table(
            ("column", "meaning"), ((f"`{c.name}`", c.meaning) for c in QUESTION_COLUMNS), "ll"
        ),
        name=name,
        revision=f', revision="{version}"' if version else "",
        shown=next(iter(questions)),
    )


def benchmark(questions: Mapping[str, Manifest], title: str) -> dict[str, bytes]:
    """Return the eval.yaml of a folder of datasets.

    The form is from https://huggingface.co/docs/hub/eval-results, "Registering a Benchmark":
    inspect-ai runs one task per split with questions as text, and one with pictures.

    Args:
        questions: The manifests of the questions, by config.
        title: The name of the benchmark.
    """
    values = yaml.safe_load(_read(EVAL))
    each, forms = values.pop("each"), values["tasks"]
    values["tasks"] = [
        {"id": f"{config}{form}-{split}", "config": config, "split": split}
        # A copy, or the file would refer to the first task in all others.
        | deepcopy(own | each)
        for config, manifest in questions.items()
        for form, own in forms.items()
        for split in _asked(manifest.config)
    ]
    text = yaml.safe_dump({"name": title} | values, sort_keys=False, allow_unicode=True, width=100)
    return {EVAL: text.encode()}


def _asked(config: DatasetConfig) -> tuple[str, ...]:
    """Return the splits whose labyrinths become questions."""
    return tuple(split for split in config.splits if split not in NOT_ASKED)


def _read(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


COMPANION = Companion(
    suffix="questions",
    columns=QUESTION_COLUMNS,
    splits=_asked,
    row="labyrinth, as a question",
    problems=question_problems,
    section=section,
    files=benchmark,
    file_names=(EVAL,),
)
