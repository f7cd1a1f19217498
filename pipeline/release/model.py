"""The policy of a run as the repository of a model: weights, what they are of, card, results."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path

import yaml
from huggingface_hub import EvalResultEntry, HfApi, eval_result_entries_to_yaml
from huggingface_hub.errors import RevisionNotFoundError

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.source import locate
from labyrinth_core.data.storage import file_sha256, write_text
from labyrinth_core.evaluation.description import TrainedRun
from labyrinth_core.evaluation.results import RESULTS, Results
from labyrinth_core.policies.load import load_policy
from labyrinth_core.policies.spec import CONFIG, OWN, WEIGHTS, NetworkSpec, PolicySpec
from pipeline.config.run import Run
from pipeline.config.training import POLICY
from pipeline.release import model_card
from pipeline.release.model_card import Trained
from pipeline.release.plan import DATASET
from pipeline.release.remote import PublishError, Remote, explained
from pipeline.release.side_files import evaluation_task

EVAL_RESULTS = ".eval_results"
"""The folder in which the Hub looks for results (https://huggingface.co/docs/hub/eval-results)."""


@contextmanager
def staged_policy(run: Run, api: HfApi) -> Iterator[Path]:
    """Yield a folder with all that the repository of the policy of a run is to hold.

    Raises:
        DatasetError: There is no policy that was evaluated, or it does not load.
        PublishError: The dataset on the Hub is not the one that it was trained on.
    """
    source = run.training_folder
    results, made = _results(source)
    with tempfile.TemporaryDirectory(prefix="labyrinth-model-") as temporary:
        folder = Path(temporary)
        _copy_weights(source, folder, made)
        spec = _spec(run, made)
        write_text(folder / CONFIG, json.dumps(spec.to_json(), indent=1) + "\n")
        try:
            network = load_policy(folder).network
        except DatasetError as error:
            told = str(error).replace(str(folder / WEIGHTS), str(source / POLICY))
            raise DatasetError(told.replace(temporary, str(source))) from error
        dataset, revision = run.dataset_on_hub
        commit, manifest = _dataset(run, api, made)
        trained = Trained(
            model=run.options.publish.model,
            version=run.options.publish.version,
            spec=spec,
            weights=sum(each.numel() for each in network.parameters()),
            dataset=dataset,
            revision=revision or commit,
            manifest=manifest,
            results=results,
            run=made,
        )
        write_text(folder / "README.md", model_card.text(trained))
        (folder / EVAL_RESULTS).mkdir()
        name = f"{dataset.rpartition('/')[2]}.yaml"
        write_text(folder / EVAL_RESULTS / name, eval_results(trained, commit))
        yield folder


def _results(folder: Path) -> tuple[Results, TrainedRun]:
    """Return the results in the folder of a run, and what they say of the run."""
    path = folder / RESULTS
    if not path.exists():
        made = "stages=[train,evaluate] makes one"
        raise DatasetError(f"{folder} holds no policy that was evaluated: {made}")
    results = Results.load(path)
    if results.run is None or results.fingerprint != results.run.fingerprint:
        raise DatasetError(f"{path} is not of this run: stages=[evaluate] makes it anew")
    return results, results.run


def _copy_weights(source: Path, folder: Path, made: TrainedRun) -> None:
    try:
        shutil.copyfile(source / POLICY, folder / WEIGHTS)
    except FileNotFoundError as error:
        raise DatasetError(f"{source / POLICY} is not there: stages=[train] makes it") from error
    if file_sha256(folder / WEIGHTS) != made.evaluated["weights"]:
        raise DatasetError(
            f"{source / RESULTS} is of other weights than {POLICY}: stages=[evaluate] makes it anew"
        )


def _spec(run: Run, made: TrainedRun) -> PolicySpec:
    """Return what the network of a run is made from; `load_policy` checks it."""
    size = run.dataset.height, run.dataset.width
    encoder, settings = made.encoder, made.settings
    of_method = OWN.get(encoder)
    own = None
    if of_method is not None:
        own = of_method(**{each.name: settings.get(each.name) for each in fields(of_method)})
    return PolicySpec(
        network=NetworkSpec(encoder, made.pool_stride, *size, str(run.dataset.task)),
        average=settings.get("average", False),
        own=own,
    )


def _dataset(run: Run, api: HfApi, made: TrainedRun) -> tuple[str, Manifest]:
    """Return the commit and the manifest of the dataset on the Hub that a run was trained on."""
    repo_id, revision = run.dataset_on_hub
    with explained(repo_id):
        try:
            commit = Remote(api, repo_id, DATASET).commit(revision or "main")
        except RevisionNotFoundError as error:
            told = f"{repo_id} has no revision {revision}: publish the dataset first"
            raise PublishError(told) from error
        manifest = Manifest.read(locate(repo_id, run.dataset.name, [], commit))
    if manifest.fingerprint != made.fingerprint:
        raise PublishError(
            f"{run.training_folder} was trained on another dataset than {repo_id}: their "
            f"fingerprints are {made.fingerprint:.8} and {manifest.fingerprint:.8}"
        )
    return commit, manifest


def eval_results(trained: Trained, commit: str) -> str:
    """Return the success rates, in percent, in the form of the Hub's file of results.

    A split of which the policy was shown a part alone, as with `train_labyrinths`, is not in it.

    Args:
        trained: The policy, its dataset and its evaluation.
        commit: The commit of the dataset.
    """
    config, manifest = trained.manifest.config.name, trained.manifest
    entries = [
        EvalResultEntry(
            dataset_id=trained.dataset,
            dataset_revision=commit,
            task_id=evaluation_task(config, split),
            value=round(100 * scores.sr, 6),
            source_url=f"https://huggingface.co/{trained.model}",
            source_name="Model card",
            notes="success rate in percent, one greedy episode a labyrinth",
        )
        for split, scores in trained.results.splits.items()
        if len(scores.distance) == sum(shard.labyrinths for shard in manifest.of(split))
    ]
    return yaml.safe_dump(eval_result_entries_to_yaml(entries), sort_keys=False)
