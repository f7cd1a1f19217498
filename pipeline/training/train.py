"""The stage `train`: train a policy on a dataset.

The folder of a run is `<run_dir>/<config>/<name>`, with the name of `RunName`. It appears when the
run is finished, with `model.safetensors`,
`config.json`, `curves.png` and `run.json`. Until then the checkpoint
is in a hidden folder next to it, and an earlier run keeps its place.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from labyrinth_core.data import Dataset
from labyrinth_core.evaluation import LabyrinthArrays, Player, RunName
from labyrinth_core.folders import WholeFolder
from labyrinth_core.learning import BaseSettings, Learner, PolicySpec, Problem
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE, ObservationSpec
from labyrinth_core.policies import RunRecord
from labyrinth_core.storage import File
from pipeline.config import Job, TrainingOptions, check
from pipeline.machinery import Sums, held, produced, progress, say, within
from pipeline.training.identity import (
    choose_device,
    find,
    identify,
    options_of,
    spec_of,
    without_place,
)
from pipeline.training.loop import (
    CHECKPOINT_SECONDS,
    INSTEAD,
    PROTOCOLS,
    Progress,
    fit,
    identity_in,
    save_tensors,
)
from pipeline.training.options import TrainOptions
from pipeline.training.record import CHECKPOINT, OURS, open_board, restore_curves, write_record

TRIED = 1_000
"""The largest number of labyrinths of train, and of validation, that evaluations during training
play; of 1,000, a success rate has a standard error of at most 1.6 percentage points."""


def refuse(job: Job[TrainOptions]) -> None:
    """Check the method and its settings before any stage starts; raise a ConfigError."""
    options = job.options
    method, _ = find(options.method_name, options.method, options.protocol)
    check(
        method.renews or options.train_labyrinths != RunName.FRESH,
        f"train_labyrinths={RunName.FRESH}: method={options.method_name} learns from the same "
        "labyrinths in each epoch; give their number, or method=bc, dagger, bco, iupe or planner",
    )


def run(job: Job[TrainOptions], *, checkpoint_seconds: float = CHECKPOINT_SECONDS) -> float:
    """Train the policy of a job, unless it is finished already; continue an interrupted run.

    Returns:
        The success rate on validation of the policy that was kept.

    Raises:
        ConfigError: A setting is not allowed, the device does not exist, or an extra is missing.
        DatasetError: The dataset is missing or lacks a split that the method needs, or the folder
            holds another run.
    """
    folder = job.options.run_folder(job.dataset)
    target = WholeFolder.of(folder, RunRecord.FILE).folder
    working = within(target.parent, f".{target.name}.training")
    method, settings = find(job.options.method_name, job.options.method, job.options.protocol)
    data = job.open_dataset(job.options.first_labyrinths)
    identity = identify(job, asdict(settings), data.fingerprint)
    kept, overwrite = Sums.read(folder).key or {}, job.options.overwrite
    if not overwrite and kept.get("fingerprint") == identity["fingerprint"]:
        # The dataset may have moved since.
        identity |= {name: kept[name] for name in ("dataset", "revision") if name in kept}
    names = [RunRecord.FILE, PolicySpec.WEIGHTS]
    if job.options.is_network_known:  # The library describes no network of a user's method.
        names.append(PolicySpec.FILE)
    rules: dict[str, Any] = {"mark": RunRecord.FILE, "names": names, "ours": OURS}
    rules |= {"overwrite": overwrite, "instead": INSTEAD}
    with held(working.parent, working.name):
        with produced(folder, options_of(identity), **rules) as made:
            if made is not None:
                path = working / CHECKPOINT
                if overwrite and path.exists() and identity_in(path) != without_place(identity):
                    File(working).remove()
                if method.protocol:
                    _tell_changes(job.options, settings)
                done = _train(job, data, made, path, identity, checkpoint_seconds)
                job.write_config(made)
        File(
            working
        ).remove()  # Only now: the next process would have continued from the checkpoint.
    if made is None:
        restore_curves(folder, folder.name)
        say(f"{folder} is complete already.")
        record = RunRecord.read(folder)
        assert record is not None  # The folder is complete.
        selected: Mapping[str, Any] = record.content["selected"]
        return float(selected["validation_sr"])
    assert done.best is not None  # The policy is always evaluated after the last epoch.
    say(
        f"{folder.name}: SR {done.best['validation_sr']:.1%} on validation, "
        f"{done.best['train_sr']:.1%} on train, after epoch {done.best['epoch']} of {done.epoch}; "
        f"{done.seconds:.0f} s. {folder}"
    )
    return float(done.best["validation_sr"])


def _train(
    job: Job[TrainOptions],
    data: Dataset,
    folder: Path,
    path: Path,
    identity: dict[str, Any],
    checkpoint_seconds: float,
) -> Progress:
    """Train a policy with its checkpoint at `path`, and write the run's files into `folder`."""
    options = job.options
    method, settings = find(options.method_name, options.method, options.protocol)
    device = choose_device(options)
    with method.seeded(job.dataset.seed, device):
        try:
            learner, judge = prepare(job, data, method, settings, device)
        finally:  # Splits of two datasets cause other errors first.
            data.require_unchanged()
        with _reporting(options, learner.settings.epochs, folder) as report:
            protocol = PROTOCOLS[options.protocol]
            done = fit(learner, judge, protocol, path, identity, report, checkpoint_seconds)
    described = {"network": json.dumps(asdict(learner.problem.spec), sort_keys=True)}
    save_tensors(folder / PolicySpec.WEIGHTS, done.weights, described)
    if options.is_network_known:
        text = json.dumps(learner.policy_spec.to_json(), indent=1)
        File(folder / PolicySpec.FILE).write_text(text + "\n")
    name = options.run_name(job.dataset).name
    write_record(folder, name, identity, done, computed_on(device))
    return done


def computed_on(device: torch.device) -> dict[str, Any]:
    """Return the device, the CPU threads, and on NVIDIA's GPUs what may be rounded to TF32."""
    computed: dict[str, Any] = {"device": device.type, "threads": torch.get_num_threads()}
    if device.type == "cuda":
        products = torch.backends.cuda.matmul.allow_tf32
        computed["tf32"] = {"convolutions": torch.backends.cudnn.allow_tf32, "products": products}
    return computed


def prepare(
    job: Job[TrainingOptions],
    data: Dataset,
    method: type[Learner],
    settings: BaseSettings,
    device: torch.device,
) -> tuple[Learner, Callable[[Learner], dict[str, float]]]:
    """Return a fresh learner, and a function that evaluates its policy on train and validation."""
    options = job.options
    spec = spec_of(job)
    size = method.image_size(spec, settings, spec.height, spec.width)

    def load(split: str, image_size: int, first: int | None = None) -> LabyrinthArrays:
        """Return the first labyrinths of a split, or all, with pictures of this size.

        If the run learns from the first labyrinths of train only, so are those of each split that
        is derived from train: the others have structures that are new to the policy.
        """
        selection = data.of_first(split, options.first_labyrinths).filter(labyrinths=first)
        seen = ObservationSpec(options.observation, image_size, True, options.resize)
        return LabyrinthArrays.of(selection, seen)

    train = load("train", DEFAULT_IMAGE_SIZE)
    shards = data.manifest.of("validation")
    counts = {"train": len(train.initial), "validation": sum(each.labyrinths for each in shards)}
    limited = [split for split, count in counts.items() if count > TRIED]
    if limited:
        most = f"the first {TRIED:,} labyrinths of {' and '.join(limited)}"
        say(f"Evaluations during training play {most}.")
    whole = size == DEFAULT_IMAGE_SIZE and "train" not in limited
    splits = {
        split: train
        if whole and split == "train"
        else load(split, size, TRIED if split in limited else None)
        for split in counts
    }

    def judge(learner: Learner) -> dict[str, float]:
        policy = learner.acting
        player = Player.of(method.player(policy, spec, settings), job.dataset.seed)
        rates = {f"{split}_sr": player.success_rate(each) for split, each in splits.items()}
        return rates | method.figures(policy, **splits)

    if options.train_labyrinths == RunName.FRESH:
        shown = data.manifest.config
        check(
            shown.min_walls == 1,
            f"train_labyrinths={RunName.FRESH}: new labyrinths may be nearer to those of test than "
            f"splits.min_walls={shown.min_walls} allows; give a dataset with splits.min_walls=1",
        )
        say(f"Each epoch draws {shown.labyrinths:,} new labyrinths from the bucket of train.")
    problem = Problem.of_dataset(
        data,
        train,
        spec,
        learner=f"method={options.method_name}",
        train_labyrinths=options.train_labyrinths,
        seed=job.dataset.seed,
        device=device,
    )
    return method(problem, settings), judge


def _tell_changes(options: TrainingOptions, settings: BaseSettings) -> None:
    """Print the settings of a run that differ from those of its protocol."""
    usual = asdict(type(settings)())
    changed = [
        f"method.{name}={value:,} instead of {usual[name]:,}"
        for name, value in asdict(settings).items()
        if value != usual[name]
    ]
    if changed:
        say(f"protocol={options.protocol}, but {', '.join(changed)}")


@contextmanager
def _reporting(
    options: TrainOptions, epochs: int, folder: Path
) -> Iterator[Callable[[Progress], None]]:
    """Yield a function that displays and logs the progress of a run after an epoch."""
    written, seconds = 0, 0.0

    def report(done: Progress) -> None:
        nonlocal written, seconds
        seconds = done.seconds
        best = "" if done.best is None else f", best SR {done.best['validation_sr']:.0%}"
        loss = f"{options.method_title} loss {done.history[-1]['loss']:.3f}"
        bars.update(bar, completed=done.epoch, description=loss + best)
        if board is not None:  # Epochs before an interruption are written again.
            for row in done.history[written:]:
                for name in sorted(row.keys() - {"epoch"}):
                    board.add_scalar(name, row[name], row["epoch"])
            board.flush()
        written = done.epoch

    with open_board(folder) if options.tensorboard else nullcontext() as board, progress() as bars:
        bar = bars.add_task(options.method_title, total=epochs)
        with bars.each_minute(bar, " epochs", lambda: seconds):
            yield report
