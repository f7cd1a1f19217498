"""The policy of a run as a model repository on the Hub: weights, config.json and card."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from huggingface_hub import EvalResult, ModelCardData

from labyrinth_core.data import SPLITS, Dataset, Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import KnownDataset, Results, TrainedRun
from labyrinth_core.learning import PolicySpec
from labyrinth_core.policies import RunRecord, load_policy
from labyrinth_core.storage import File
from pipeline.config import Job
from pipeline.inspection import front_matter
from pipeline.machinery import count, plain, table
from pipeline.release.faults import PublishError
from pipeline.release.options import PublishStageOptions
from pipeline.release.texts import citation, code, fill, paragraph, verbatim


@dataclass(frozen=True)
class Trained:
    """A policy to publish, with its runs, results and dataset."""

    job: Job[PublishStageOptions]
    """The run that publishes the policy, with its name on the Hub, its version and its dataset."""
    made: TrainedRun
    """The run that trained the policy, as the results describe it."""
    spec: PolicySpec
    weights: int
    """The number of weights."""
    results: Results
    """The results of the policy on the dataset."""
    commit: str
    """The commit of the dataset on the Hub."""
    manifest: Manifest
    """The manifest of the dataset at that commit."""

    @property
    def revision(self) -> str:
        """The revision of the dataset as the user named it, else its commit."""
        return self.job.options.dataset_on_hub[1] or self.commit


def published_dataset(job: Job[PublishStageOptions], *, is_unseen: bool) -> tuple[str, Manifest]:
    """Return the commit and the manifest of the dataset on the Hub that a run names.

    Args:
        job: The options, and the dataset to make.
        is_unseen: Whether a dry run cannot reach the Hub: the dataset of `data_dir` then replaces
            the one on the Hub, with a commit of zeros.

    Raises:
        DatasetError: The Hub has no such revision or refuses, or `data_dir` has no dataset.
    """
    if is_unseen:
        return 40 * "0", Dataset.at(job.folder).manifest
    repo_id, revision = job.options.dataset_on_hub
    dataset = Dataset(repo_id, job.dataset.name, revision)
    return str(dataset.commit), dataset.manifest


def stage_policy(
    job: Job[PublishStageOptions], folder: Path, commit: str, manifest: Manifest
) -> None:
    """Write all files of the model repository of a run's policy.

    Args:
        job: The options that name the run that trained it.
        folder: The folder to write them in.
        commit: The commit of the dataset on the Hub.
        manifest: The manifest of that dataset.

    Raises:
        DatasetError: The run has no evaluated policy, or the policy does not load.
        PublishError: The policy was trained on another dataset than the one on the Hub.
    """
    source = job.options.run_folder(job.dataset)
    results, made, record = _results(job, commit, manifest)
    policy = load_policy(source)
    if File(source / PolicySpec.WEIGHTS).sha256() != made.evaluated["weights"]:
        again = "stages=evaluate makes it again"
        raise DatasetError(
            f"{source / Results.FILE} is for other weights than {PolicySpec.WEIGHTS}: {again}"
        )
    for name in (PolicySpec.WEIGHTS, PolicySpec.FILE):
        shutil.copyfile(source / name, folder / name)
    repo_id, _ = job.options.dataset_on_hub  # The run names a folder of its own machine.
    run = {**record.content["run"], "dataset": repo_id, "revision": commit}
    content = {**record.content, "run": run}
    File(folder / RunRecord.FILE).write_text(json.dumps(content, indent=1) + "\n")
    weights = sum(each.numel() for each in policy.network.parameters())
    trained = Trained(job, made, policy.spec, weights, results, commit, manifest)
    File(folder / "README.md").write_text(_card(trained))


def _results(
    job: Job[PublishStageOptions], commit: str, manifest: Manifest
) -> tuple[Results, TrainedRun, RunRecord]:
    """Return the results in the folder of a run, their description of the run, and its record."""
    folder = job.options.run_folder(job.dataset)
    path, anew = folder / Results.FILE, "stages=evaluate makes it again"
    if not path.exists():
        made = "'stages=[train,evaluate]' makes one"
        raise DatasetError(f"{folder} holds no evaluated policy: {made}")
    results = Results.load(path)
    named = job.dataset.name, job.options.run_name(job.dataset).name, results.fingerprint
    made_by = results.run
    if made_by is None or (results.config, made_by.name, made_by.fingerprint) != named:
        raise DatasetError(f"{path} belongs to another run: {anew}")
    if manifest.fingerprint != made_by.fingerprint:
        raise PublishError(
            f"{folder} was trained on another dataset than {job.options.dataset_on_hub[0]}: their "
            f"fingerprints are {made_by.fingerprint:.8} and {manifest.fingerprint:.8}"
        )
    results = Results.load(path, lambda _: _known(job, commit, manifest))
    record = RunRecord.read(folder)
    if record is None:
        raise DatasetError(f"{folder} holds no finished run: stages=train makes it")
    run = record.trained_run()
    if (run.training, run.settings) != (made_by.training, made_by.settings):
        raise DatasetError(f"{path} describes another training than {RunRecord.FILE}: {anew}")
    return results, made_by, record


def _known(job: Job[PublishStageOptions], commit: str, manifest: Manifest) -> KnownDataset:
    """Return the dataset to check results against: the same one in data_dir, else on the Hub."""
    if (job.folder / Manifest.FILE).is_file() and (
        local := Dataset.at(job.folder)
    ).manifest == manifest:
        return KnownDataset(local)
    return KnownDataset(Dataset(job.options.dataset_on_hub[0], job.dataset.name, commit))


def _front_matter(trained: Trained) -> dict[str, Any]:
    """Return the values at the head of the card, with SPL and SR of each split as `model-index`.

    A split that was evaluated only in part, as with `train_labyrinths`, is left out.
    """
    dataset, _ = trained.job.options.dataset_on_hub
    config = trained.manifest.config.name
    results = [
        EvalResult(
            task_type="reinforcement-learning",
            dataset_type=dataset,
            dataset_name=f"{config} of {dataset}",
            dataset_config=config,
            dataset_split=split,
            dataset_revision=trained.commit,
            metric_type=name.lower(),
            metric_name=name,
            metric_value=round(value, 8),
        )
        for split, scores in trained.results.splits.items()
        if len(scores.distance) == sum(shard.labyrinths for shard in trained.manifest.of(split))
        for name, value in (("SPL", scores.spl), ("SR", scores.sr))
    ]
    data = ModelCardData(
        license=front_matter.LICENCE,
        library_name="labyrinth-datasets",
        pipeline_tag="reinforcement-learning",
        datasets=[dataset],
        tags=["imitation-learning", "generalization", "labyrinth", "arxiv:2509.24784"],
        model_name=trained.job.options.publish.model.rpartition("/")[2],
        eval_results=results,
    )
    return dict(data.to_dict())  # type: ignore[no-untyped-call]


def _card(trained: Trained) -> str:
    """Return the README.md, a pure function of the evaluation and the dataset."""
    test = trained.results.splits["test"]
    low, high = (f"{100 * bound:.0f}" for bound in test.figures()["sr_interval"])
    spec, options = trained.spec, trained.job.options.publish
    form = "a function from a batch of observations to the scores of the four actions"
    if spec.remembers:
        form = "an object with `reset(count)` and `act(observations)`, which returns actions"
    text = fill(
        "model.md",
        dataset=trained.job.options.dataset_on_hub[0],
        method=plain(trained.made.method),
        config=trained.manifest.config.name,
        sees=_sees(spec),
        spl=f"{test.spl:.1%}",
        solved=f"{test.sr:.1%}",
        low=low,
        high=high,
        labyrinths=f"{len(test.distance):,}",
        why=Results.WHY_SPL,
        model=options.model,
        version=options.version,
        revision=trained.revision,
        form=form,
        weights=f"{trained.weights:,}",
        training=_training(trained),
        results=_table_of_results(trained),
        limits="\n".join(f"- {limit}" for limit in _limits(trained)),
        code=code(),
        citation=citation(),
    )
    return front_matter.with_values(_front_matter(trained), text)


def _sees(spec: PolicySpec) -> str:
    if spec.image_size is None:
        return "vectors"
    pictures = f"pictures of {spec.image_size} x {spec.image_size} pixels"
    if spec.resize == "original":
        pictures += " (walls of two pixels, resized without antialiasing: most walls vanish)"
    return pictures


def _training(trained: Trained) -> str:
    made, training = trained.made, trained.made.training
    config, (dataset, _) = trained.manifest.config.name, trained.job.options.dataset_on_hub
    asked = made.train_labyrinths
    held = sum(shard.labyrinths for shard in trained.manifest.of("train"))
    if isinstance(asked, str):
        learnt = f"new labyrinths of the bucket of `train`, {held:,} in each epoch"
    else:
        learnt = f"{count(held if asked is None else asked, 'labyrinth')} of `train`"
        learnt += "" if asked is None else f", the first of {held:,}"
    rows = [
        ("dataset", f"`{config}` of `{dataset}`, revision `{trained.revision}`"),
        ("its fingerprint", f"`{made.fingerprint}`"),
        ("learnt from", learnt),
        (
            "method",
            f"{verbatim(made.method)}, encoder {verbatim(made.encoder)}, seed {made.seed}",
        ),
        ("settings", ", ".join(verbatim(f"{n}={value}") for n, value in made.settings.items())),
        (
            "budget",
            f"{count(training['epochs'], 'epoch')}, {training['seconds']:.0f} seconds on "
            f"{plain(training['computed']['device'])}",
        ),
        (
            "chosen",
            f"the weights after epoch {training['selected']['epoch']}, by the success rate on "
            "`validation`",
        ),
    ]
    return table(("what", "value"), rows, "ll")


def _table_of_results(trained: Trained) -> str:
    rows = []
    for split, scores in trained.results.splits.items():
        figures = scores.figures()
        low, high = figures["sr_interval"]
        efficiency = figures["path_efficiency"]
        chance = trained.results.baselines["random"][split]
        rows.append(
            (
                f"`{split}`",
                SPLITS[split].meaning,
                f"{figures['labyrinths']:,}",
                f"{figures['spl']:.1%}",
                f"{figures['sr_within_cells']:.1%}",
                f"{figures['sr']:.1%}",
                f"{100 * low:.0f}-{100 * high:.0f}",
                f"{figures['aer']:.2f} ± {figures['aer_std']:.2f}",
                "-" if efficiency is None else f"{efficiency:.1%}",
                f"{chance['spl']:.1%} / {chance['sr']:.1%}",
            )
        )
    heading = ("split", "holds", "labyrinths", "SPL", "SR in n x n", "SR", "95%", "AER")
    return table((*heading, "efficiency", "random"), rows, "ll" + "r" * 8)


def _limits(trained: Trained) -> list[str]:
    """Return the limits of the results, a paragraph each."""
    spec = trained.spec
    names = ["one_seed", "chosen"]
    names += ["plans_once" if spec.remembers else "no_memory"]
    names += ["pictures"] * (spec.observation == "image")
    names += ["knowledge"] * spec.knows_how_to_plan
    limits = [paragraph(f"policy_{name}") for name in names]
    receipt = trained.results.memorised
    if receipt is not None:
        figures = {"excess": f"{receipt.excess:+z.2f}", "most": f"{receipt.most:.1f}"}
        figures |= {"p": f"{receipt.p:.3f}", "drawn": f"{receipt.drawn:,}"}
        limits.append(paragraph("policy_memorised", **figures))
    return limits
