"""Evaluate the policy of a run on all splits but `random`, of its own dataset or another one."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.datasets import Dataset
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.evaluation.answers import Player
from labyrinth_core.evaluation.description import Description, TrainedRun
from labyrinth_core.evaluation.evaluate import judge, way_of
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.results import RESULTS, Results
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS
from labyrinth_core.pictures.vector import tile_count
from labyrinth_core.policies.networks.network import usual_defaults
from labyrinth_core.policies.record import read_run
from labyrinth_core.policies.spec import POLICY
from pipeline.config.errors import check
from pipeline.config.options import source_of
from pipeline.config.stage import Job
from pipeline.config.training import run_name, training_folder
from pipeline.evaluation.named import Judged, require_free
from pipeline.evaluation.options import EvaluateOptions
from pipeline.machinery.console import say, tracked
from pipeline.machinery.dataset import dataset_of
from pipeline.training.checkpoint import options_of, read_policy, require_same, without_place
from pipeline.training.methods.method import find
from pipeline.training.record import training_versions
from pipeline.training.train import choose_device, identify, loader_of, spec_of


@usual_defaults()
def judge_trained(job: Job[EvaluateOptions]) -> Judged:
    """Evaluate the policy of a run on its own dataset or on `evaluate_on`; return its results.

    Raises:
        ConfigError: The device does not exist, a folder is given with a revision, or the policy
            does not support the labyrinths of `evaluate_on`.
        DatasetError: The run is not finished, it was trained with other settings than the given
            ones, its dataset has changed since, or a dataset or a split is missing.
    """
    folder, options = training_folder(job), job.options
    record = read_run(folder)
    if record is None:
        raise DatasetError(f"{folder} holds no finished run: stages=train makes it")
    device, about = choose_device(options), record["run"]
    named = identify(job, about["settings"], about["fingerprint"])
    another = ": move it elsewhere, or replace it with stages=train overwrite=true"
    require_same(f"{folder} was trained", without_place(about), without_place(named), another)
    method, settings = find(options.method_name, about["settings"], options.protocol)
    _, asked = find(options.method_name, about["settings"] | options.method, options.protocol)
    advice = ": leave the option out, or train with it first"
    require_same(f"{folder} was trained", about, about | {"settings": asdict(asked)}, advice)
    spec = spec_of(job)
    make = partial(method.make, settings=settings)
    policy = read_policy(folder / POLICY, spec, device, make)
    judged_on = elsewhere(job) if options.evaluate_on else job
    data = dataset_of(judged_on, judged_on.options.first_labyrinths)
    config, fingerprint = data.manifest.config, data.fingerprint
    if judged_on is job and fingerprint != about["fingerprint"]:
        raise DatasetError(
            f"{folder} was trained on another dataset than {source_of(job)}: their fingerprints "
            f"are {about['fingerprint']:.8} and {fingerprint:.8}; evaluate_on={source_of(job)}/"
            f"{config.name} evaluates it on that dataset anyway"
        )
    path = folder / RESULTS
    if judged_on is not job:
        path = path.with_stem(f"{path.stem}-{config.name}-{fingerprint:.8}")
    require_free(path, options_of(about), job)
    size = method.image_size(spec, settings, config.height, config.width)
    shape = replace(spec, height=config.height, width=config.width)
    acting = method.player(policy, shape, settings)
    player, load = Player.of(acting, job.dataset.seed), loader_of(judged_on, data, size)
    learnt = None if judged_on is job else learnt_from(job, about["fingerprint"], config)
    splits = (*EVALUATED_SPLITS, *config.shifts)
    scores, baselines = judge(
        player,
        load,
        tracked(((1, split) for split in splits), "evaluate", len(splits)),
        config.task,
        learnt=learnt,
        blind=True,
    )
    data.require_unchanged()
    as_tried = None
    if method.protocol:
        as_tried = {split: method.as_tried(policy, load(split)) for split in splits}
        rates = (f"{split} {figures['sr']:.0%}" for split, figures in as_tried.items())
        say(f"Evaluated as in the code of protocol={options.protocol}: {', '.join(rates)}")
    made = TrainedRun(
        **asdict(run_name(job)),
        settings=about["settings"],
        config=job.dataset.name,
        dataset=about["dataset"],
        revision=about["revision"],
        fingerprint=about["fingerprint"],
        training={name: record[name] for name in ("epochs", "seconds", "selected", "computed")},
        evaluated={
            "device": device.type,
            "versions": training_versions(),
            "weights": record["files"][POLICY],
        },
        references_know=None if learnt is None else about["fingerprint"],
        as_tried=as_tried,
    )
    results = Results(
        dataset=source_of(judged_on),
        revision=judged_on.options.revision,
        config=config.name,
        fingerprint=fingerprint,
        observation=options.observation,
        image_size=size if options.observation == "image" else None,
        way=way_of(player),
        episodes=1,
        seed=job.dataset.seed,
        splits=scores,
        baselines=baselines,
        run=made,
    )
    return Judged(Description(made.name), player, load, results, path, options_of(about))


def elsewhere(job: Job[EvaluateOptions]) -> Job[EvaluateOptions]:
    """Return a copy of the run with `evaluate_on` as its dataset.

    Raises:
        ConfigError: The policy observes vectors, which have another meaning in that dataset.
        DatasetError: The dataset does not exist.
    """
    source, _, name = job.options.evaluate_on.rstrip("/").rpartition("/")
    config, trained_on = Dataset(source, name).manifest.config, job.dataset

    def vectors(of: DatasetConfig) -> tuple[int, int, int]:
        return of.height, of.width, tile_count(of.task)

    check(
        job.options.observation != "vector" or vectors(config) == vectors(trained_on),
        f"evaluate_on={job.options.evaluate_on}: the policy observes vectors of {trained_on.name}, "
        f"which have another format than those of {name}",
    )
    options = replace(job.options, dataset=source, revision=None, train_labyrinths=None)
    return replace(job, options=options, dataset=config)


def learnt_from(
    job: Job[EvaluateOptions], fingerprint: str, config: DatasetConfig
) -> LabyrinthArrays | None:
    """Return the labyrinths that the policy learnt from; None if they are unavailable.

    Also None if `config` differs in size or task, so that nothing could be remembered.
    """
    trained_on = job.dataset
    for name in ("height", "width", "task"):
        if getattr(config, name) != getattr(trained_on, name):
            return None
    try:
        data = dataset_of(job)
    except DatasetError:
        return None
    return loader_of(job, data)("train", "vector") if data.fingerprint == fingerprint else None
