"""The stage `evaluate`: evaluates the policy of a run on all splits but `random`, in its folder.

Nothing is selected or learnt here: the policy acts in one greedy episode per labyrinth.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Column, Table

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.source import locate
from labyrinth_core.data.storage import file_sha256, write_text
from labyrinth_core.evaluation.baselines import compare
from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.references import TrainMemory
from labyrinth_core.evaluation.replanner import replan
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS, Scores, score, stepped_score
from labyrinth_core.evaluation.stepping import Player
from labyrinth_core.pictures.vector import tile_count
from labyrinth_core.world.labyrinth import Task
from pipeline.config.errors import check
from pipeline.config.run import Run
from pipeline.config.training import PROTOCOLS
from pipeline.machinery.console import console, say, tracked
from pipeline.machinery.dataset import manifest_of
from pipeline.machinery.evaluation_file import EVALUATION, FORMAT, POLICY
from pipeline.machinery.moving_pictures import write_attempts
from pipeline.training.memory import memory_of, with_memory
from pipeline.training.methods.method import find
from pipeline.training.policy import read_policy
from pipeline.training.record import current_versions, read_record
from pipeline.training.train import choose_device, loader_of, spec_of

CAPTION = (
    "SPL: success weighted by path length. known: SR where train demonstrates an optimal route; "
    "new: where it does not. optimal: share of optimal actions, in the states of the "
    "demonstrations / in all others."
)


def run(run: Run) -> None:
    """Evaluate the policy of a run, on the dataset that it was trained on or on `evaluate_on`.

    Raises:
        ConfigError: There is no such device, a folder is given with a revision, or the policy
            cannot see the labyrinths of `evaluate_on`.
        DatasetError: There is no finished run, it was trained on another dataset than the one that
            exists now, or a dataset or a split is missing.
    """
    folder, options = run.training_folder, run.options
    record = read_record(folder)
    if record is None:
        raise DatasetError(f"{folder} holds no finished run: stages=[train] makes it")
    device = choose_device(options)
    about = record["run"]
    method, settings = find(about["method"], about["settings"], about["protocol"])
    make, spec = partial(method.make, settings=settings), spec_of(run)
    policy = read_policy(folder / POLICY, spec, device, make)
    judged = elsewhere(run) if options.evaluate_on else run
    manifest = manifest_of(judged)
    config, fingerprint = manifest.config, manifest.fingerprint
    if judged is run and fingerprint != record["run"]["fingerprint"]:
        raise DatasetError(
            f"{folder} was trained on another dataset than {run.source}: their fingerprints "
            f"are {record['run']['fingerprint']:.8} and {fingerprint:.8}; evaluate_on={run.source}/"
            f"{config.name} evaluates it there all the same"
        )
    size = method.image_size(spec, settings, config.height, config.width)
    shape = replace(spec, height=config.height, width=config.width)
    acting = with_memory(method.player(policy, shape, settings), memory_of(run, config, size))
    player = Player.of(acting, options.seed)
    learnt = None if judged is run else learnt_from(run, record, config)
    scores, baselines = judge(player, loader_of(judged, size), config, learnt)
    computed = {
        "device": device.type,
        "versions": current_versions(),
        "weights": file_sha256(folder / POLICY),
    }
    content, name = describe(record, scores, baselines, computed), EVALUATION
    if PROTOCOLS[about["protocol"]].methods:
        load = loader_of(judged, size)
        content["as_tried"] = {split: method.as_tried(policy, load(split)) for split in scores}
        _tell_trial(about["protocol"], content["as_tried"])
    if judged is not run:
        name = f"evaluation-{config.name}-{fingerprint:.8}.json"
        remembered = fingerprint if learnt is None else record["run"]["fingerprint"]
        content["evaluated"] |= {"on": options.evaluate_on, "fingerprint": fingerprint}
        content["evaluated"]["references_know"] = remembered
        del content["train_test_gap"]  # The policy was not trained on that train.
    write_text(folder / name, as_text(content))
    if options.evaluation.gifs:
        test, solved = loader_of(judged, size)("test"), scores["test"].episodes.solved
        paths = write_attempts(folder, player, test, solved, options.evaluation.gifs, options.seed)
        say(f"{paths[0].parent} has {len(paths)} moving pictures.")
    for table in summaries(f"{run.training_name} on {judged.source}/{config.name}", content):
        console.print(table)


def _tell_trial(protocol: str, tried: Mapping[str, Mapping[str, float]]) -> None:
    """Print the success rate on each split by a protocol's own rules."""
    rates = (f"{split} {figures['sr']:.0%}" for split, figures in tried.items())
    say(f"As the code of protocol={protocol} tries a policy: {', '.join(rates)}")


def elsewhere(run: Run) -> Run:
    """Return the run with the dataset of `evaluate_on` in place of the one that it was trained on.

    Raises:
        ConfigError: The policy sees vectors, which have another meaning there.
        DatasetError: There is no such dataset.
    """
    source, _, name = run.options.evaluate_on.rpartition("/")
    config, trained_on = Manifest.read(locate(source, name, [])).config, run.dataset

    def vectors(of: DatasetConfig) -> tuple[int, int, int]:
        return of.height, of.width, tile_count(of.task)

    check(
        run.options.observation != "vector" or vectors(config) == vectors(trained_on),
        f"evaluate_on={run.options.evaluate_on}: observation=vector has other vectors at {name} "
        f"than at {trained_on.name}, where the policy was trained",
    )
    options = replace(run.options, dataset=source, revision=None, train_labyrinths=None)
    return replace(run, options=options, dataset=config)


def learnt_from(
    run: Run, record: Mapping[str, Any], config: DatasetConfig
) -> LabyrinthArrays | None:
    """Return the labyrinths that a policy learnt from; None if they are not at hand.

    None, too, if those of `config` have another size or task, where nothing can be remembered.
    """
    trained_on = run.dataset
    for name in ("height", "width", "task"):
        if getattr(config, name) != getattr(trained_on, name):
            return None
    try:
        at_hand = manifest_of(run).fingerprint == record["run"]["fingerprint"]
    except DatasetError:
        return None
    return loader_of(run)("train") if at_hand else None


def judge(
    player: Player,
    load: Callable[..., LabyrinthArrays],
    config: DatasetConfig,
    learnt: LabyrinthArrays | None = None,
) -> tuple[dict[str, Scores], dict[str, dict[str, dict[str, float]]]]:
    """Return a policy's scores on each split of a dataset, and the figures of the baselines.

    The references know `learnt`, the labyrinths that the policy learnt from; None: the split train.
    """
    scores: dict[str, Scores] = {}
    baselines: dict[str, dict[str, dict[str, float]]] = {}
    splits = (*EVALUATED_SPLITS, *config.shifts)
    for split in tracked(((1, split) for split in splits), "evaluate", len(splits)):
        arrays = load(split)
        if split == "train":
            train = arrays if learnt is None else learnt
            memory = TrainMemory.of(train)
        known, references = memory.figures(arrays)
        found = score(player.act, arrays) if player.forgets else stepped_score(player, arrays)
        scores[split] = replace(found, known_route=known)
        baselines[split] = compare(train, arrays) | references
        if config.task is Task.PARTIAL_OBSERVABILITY:
            baselines[split] |= replan(load(split, observation="vector"))
    return scores, baselines


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
    headings = ("SR", "95%", "SPL", "known / new", "AER", "optimal", "failures")
    table = _table(headings, f"{name}, one greedy episode per labyrinth", CAPTION)
    for split, figures in content["splits"].items():
        low, high = figures["sr_interval"]
        table.add_row(
            split,
            f"{figures['sr']:.1%}",
            f"{100 * low:.0f}-{100 * high:.0f}",
            f"{figures['spl']:.0%}",
            _pair(figures["sr_known_route"], figures["sr_new_route"]),
            f"{figures['aer']:.2f}",
            _pair(figures["accuracy_on_demonstrations"], figures["accuracy_elsewhere"]),
            ", ".join(f"{count} {name}" for name, count in figures["failures"].items()) or "none",
        )
    yield table
    names = list(content["baselines"]["train"])
    headings = tuple(name.replace("_", " ") for name in names)
    table = _table(headings, "SR / SPL without learning, in percent")
    for split, figures in content["baselines"].items():
        told = (_pair(figures[name]["sr"], figures[name]["spl"]) for name in names)
        table.add_row(split, *told)
    yield table


def _table(headings: Sequence[str], title: str, caption: str | None = None) -> Table:
    columns = (Column(heading, justify="right") for heading in headings)
    first = Column("split", no_wrap=True)
    table = Table(first, *columns, title=title, caption=caption, box=SIMPLE_HEAD, pad_edge=False)
    table.caption_justify = "left"
    return table


def _pair(first: float | None, second: float | None) -> str:
    """Return two shares in percent."""
    shares = (first, second)
    return " / ".join("-" if share is None else f"{100 * share:.0f}" for share in shares)
