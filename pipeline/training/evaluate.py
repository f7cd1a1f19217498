"""The stage `evaluate`: evaluates the policy of a run on all splits but `random`, in its folder.

Nothing is selected or learnt here: the policy acts in one greedy episode per labyrinth.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from rich.table import Column, Table

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.storage import file_sha256, write_text
from labyrinth_core.evaluation.baselines import BASELINES, compare
from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS, Scores, score
from pipeline.config.run import Run
from pipeline.machinery.console import console, tracked
from pipeline.machinery.dataset import manifest_of
from pipeline.machinery.evaluation_file import EVALUATION, FORMAT, POLICY
from pipeline.training.methods.method import find
from pipeline.training.policy import load_policy
from pipeline.training.record import current_versions, read_record
from pipeline.training.train import choose_device, loader_of, spec_of


def run(run: Run) -> None:
    """Evaluate the policy of a run.

    Raises:
        ConfigError: There is no such device, or a folder is given with a revision.
        DatasetError: There is no finished run, it was trained on another dataset than the one that
            exists now, or the dataset lacks a split.
    """
    folder = run.training_folder
    record = read_record(folder)
    if record is None:
        raise DatasetError(f"{folder} holds no finished run: stages=[train] makes it")
    device = choose_device(run.options)
    method, settings = find(record["run"]["method"], record["run"]["settings"])
    make = partial(method.make, settings=settings)
    policy = load_policy(folder / POLICY, spec_of(run), device, make)
    manifest = manifest_of(run)
    fingerprint = manifest.fingerprint
    if fingerprint != record["run"]["fingerprint"]:
        raise DatasetError(
            f"{folder} was trained on another dataset than {run.source}: their fingerprints "
            f"are {record['run']['fingerprint']:.8} and {fingerprint:.8}"
        )
    scores: dict[str, Scores] = {}
    baselines: dict[str, Any] = {}
    load, splits = loader_of(run), (*EVALUATED_SPLITS, *manifest.config.shifts)
    for split in tracked(((1, split) for split in splits), "evaluate", len(splits)):
        arrays = load(split)
        if split == "train":
            train = arrays
        scores[split] = score(policy, arrays)
        baselines[split] = compare(train, arrays)
    computed = {
        "device": device.type,
        "versions": current_versions(),
        "weights": file_sha256(folder / POLICY),
    }
    content = describe(record, scores, baselines, computed)
    write_text(folder / EVALUATION, as_text(content))
    for table in summaries(run.training_name, content):
        console.print(table)


def describe(
    record: Mapping[str, Any],
    scores: Mapping[str, Scores],
    baselines: Mapping[str, Any],
    computed: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the content of `evaluation.json`, in plain types.

    `record` is the content of `run.json`; `scores` and the figures of `baselines` are by split;
    `computed` tells the device, the versions of libraries and the SHA-256 of the weights.
    """
    solved = [scores[split].episodes.solved[None].astype(float) for split in ("train", "test")]
    return {
        "format": FORMAT,
        "run": record["run"],
        "training": {name: record[name] for name in ("epochs", "seconds", "selected", "computed")},
        "evaluated": dict(computed),
        "train_test_gap": {
            "sr": scores["train"].sr - scores["test"].sr,
            "sr_interval": list(interval(*solved)),
            "aer": scores["train"].aer - scores["test"].aer,
        },
        "splits": {split: scores[split].to_json() for split in scores},
        "baselines": dict(baselines),
    }


def as_text(content: Mapping[str, Any]) -> str:
    """Return readable JSON: one line for each entry of the first two levels."""
    lines = []
    for key, value in content.items():
        text = json.dumps(value)
        if isinstance(value, dict):
            inner = (f"  {json.dumps(name)}: {json.dumps(each)}" for name, each in value.items())
            text = "{\n" + ",\n".join(inner) + "\n }"
        lines.append(f" {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def summaries(name: str, content: Mapping[str, Any]) -> Iterator[Table]:
    """Yield the tables of the policy's scores and of the baselines."""
    right = partial(Column, justify="right")
    headings = ("SR", "95%", "AER", "optimal*", "failures")
    table = Table("split", *map(right, headings), title=f"{name}, one greedy episode per labyrinth")
    for split, figures in content["splits"].items():
        low, high = figures["sr_interval"]
        shares = [figures[f"accuracy_{where}"] for where in ("on_demonstrations", "elsewhere")]
        table.add_row(
            split,
            f"{figures['sr']:.1%}",
            f"{100 * low:.0f}-{100 * high:.0f}",
            f"{figures['aer']:.2f} ± {figures['aer_std']:.2f}",
            " / ".join("-" if share is None else f"{share:.0%}" for share in shares),
            ", ".join(f"{count} {name}" for name, count in figures["failures"].items()) or "none",
        )
    table.caption = "*share of optimal actions, in the demonstrations' states / in all others"
    yield table
    named = (right(name.replace("_", " ")) for name in BASELINES)
    table = Table("split", *named, title="SR without learning")
    for split, figures in content["baselines"].items():
        table.add_row(split, *(f"{figures[name]['sr']:.1%}" for name in BASELINES))
    yield table
