"""The repositories derived from a dataset: exports for LeRobot and Minari, and an environment.

An export repository holds one config, in the form that the library reads from the Hub. LeRobot
reads one dataset at the root, so its repository holds one split. Minari reads a group of datasets
whose ids begin with the name of the repository (`minari.storage.remotes.huggingface` of
https://pypi.org/project/minari/, 0.5.4).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from labyrinth_core.data import SPLITS, Dataset, Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import File
from pipeline.config import ExportOptions, Job
from pipeline.inspection import front_matter
from pipeline.machinery import Sums, table
from pipeline.release.model import published_dataset
from pipeline.release.options import PublishStageOptions
from pipeline.release.texts import citation, code, command_lines, fill, paragraph

LIBRARIES = {"lerobot": "LeRobot", "minari": "Minari"}
"""Format -> the library that an export is for."""

NAMESPACE_METADATA = "namespace_metadata.json"
"""The file that marks a Minari group, and each group within a group."""


def loading(job: Job[PublishStageOptions]) -> str:
    """Return the line that loads a run's export from the Hub; for Minari, its first split."""
    options, name = job.options, job.options.publish.export
    if options.export.format == "lerobot":
        return f'LeRobotDataset("{name}")'
    owner, _, group = name.partition("/")
    split = (*options.export.splits, *job.dataset.splits)[0]
    id_ = f"{group}/{job.dataset.name}/{split}-v{ExportOptions.VERSION}"
    return f"MINARI_REMOTE=hf://{owner} minari download {id_}"


def stage_export(job: Job[PublishStageOptions], folder: Path, *, is_unseen: bool) -> None:
    """Write all files of the repository of a run's export, exported files as symbolic links.

    Args:
        job: The dataset, the format and the splits.
        folder: The folder to write them in.
        is_unseen: As for `published_dataset`.

    Raises:
        ConfigError: The dataset has no such split.
        DatasetError: The export of a split is missing, damaged, or of another dataset or options.
        PublishError: The dataset is not on the Hub under the id that was given.
    """
    asked, (commit, manifest) = job.options.export, _origin(job, is_unseen)
    splits = tuple(dict.fromkeys(asked.splits)) or manifest.config.splits
    asked.check_splits(manifest.config.splits)
    if asked.format == "lerobot":
        records = {split: _linked(job, manifest, split, folder) for split in splits}
    else:
        group = folder / job.dataset.name
        records = {
            split: _linked(job, manifest, split, group / f"{split}-v{asked.VERSION}")
            for split in splits
        }
        _group(folder, job, splits)
    File(folder / "README.md").write_text(_card(job, manifest, records, commit))


def _origin(job: Job[PublishStageOptions], is_unseen: bool) -> tuple[str | None, Manifest]:
    """Return the dataset's commit on the Hub (None if it has no id there) and its manifest."""
    is_elsewhere = job.options.dataset is not None
    if job.options.publish.repo_id or (is_elsewhere and not Dataset.is_folder(job.source)):
        return published_dataset(job, is_unseen=is_unseen)
    return None, job.open_dataset().manifest


def _linked(
    job: Job[PublishStageOptions], manifest: Manifest, split: str, folder: Path
) -> dict[str, Any]:
    """Link the files of the export of a split into a folder, and return its record.

    Raises:
        DatasetError: The export is missing, damaged, or of another dataset or options.
    """
    source, size = (
        job.options.export.path(job.dataset.name) / f"{split}-v{ExportOptions.VERSION}",
        job.options.export.image_size,
    )
    own = Sums.read(source)
    if not own.hashes or not all(own.has(name) for name, _ in own.hashes):
        raise DatasetError(f"{source} holds no complete export: stages=export makes it")
    record: dict[str, Any] = json.loads((source / ExportOptions.RECORD).read_bytes())
    if (record["fingerprint"], record["image_size"]) != (manifest.fingerprint, size):
        raise DatasetError(
            f"{source} is an export of another dataset, or with other options: stages=export "
            "overwrite=true replaces it"
        )
    for name in {name for name, _ in own.hashes} - {
        job.CONFIG
    }:  # It names folders of this machine.
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).symlink_to((source / name).absolute())
    return record


def _group(folder: Path, job: Job[PublishStageOptions], splits: Sequence[str]) -> None:
    """Make the exports in a folder a Minari group: write its metadata and the datasets' ids."""
    group = job.options.publish.export.rpartition("/")[2]
    names = [f"{job.dataset.name}/{split}-v{ExportOptions.VERSION}" for split in splits]
    ids = [f"{group}/{name}" for name in names]
    for id_, name in zip(ids, names, strict=True):
        path = folder / name / "data" / "metadata.json"
        content = json.loads(path.read_bytes()) | {"dataset_id": id_}
        path.unlink()  # The link, not its target.
        File(path).write_text(json.dumps(content))
    held = {"datasets": ids, "namespaces": [f"{group}/{job.dataset.name}"]}
    File(folder / NAMESPACE_METADATA).write_text(json.dumps(held, indent=1) + "\n")
    File(folder / job.dataset.name / NAMESPACE_METADATA).write_text("{}\n")


def _card(
    job: Job[PublishStageOptions],
    manifest: Manifest,
    records: Mapping[str, Mapping[str, Any]],
    commit: str | None,
) -> str:
    """Return the README.md, a pure function of the exports and of the release."""
    name, format_ = job.options.publish.export, job.options.export.format
    owner, _, group = name.partition("/")
    split, first = next(iter(records.items()))
    repo_id = None if commit is None else job.options.dataset_on_hub[0]
    rows = [
        (f"`{split}`", SPLITS[split].meaning, f"{each['episodes']:,}", f"{each['rows']:,}")
        for split, each in records.items()
    ]
    id_ = f"{group}/{job.dataset.name}/{split}-v{ExportOptions.VERSION}"
    text = fill(
        "export.md",
        library=LIBRARIES[format_],
        config=job.dataset.name,
        size=first["image_size"],
        splits=table(("split", "holds", "episodes", "states"), rows, "llrr"),
        use=fill(f"{format_}.md", name=name, owner=owner, id=id_).strip(),
        origin=f"{paragraph('export_origin', dataset=repo_id, commit=commit)}\n\n"
        if repo_id
        else "",
        command=command_lines(manifest.config),
        fingerprint=manifest.fingerprint,
        code=code(),
        citation=citation(),
    )
    return front_matter.with_values(_front_matter(format_, split, first["licence"], repo_id), text)


def _front_matter(format_: str, split: str, licence: str, repo_id: str | None) -> dict[str, Any]:
    """Return the values at the head of the card.

    Args:
        format_: The format.
        split: The first split; the only one for LeRobot.
        licence: The licence of the dataset.
        repo_id: The id of the dataset on the Hub, if it has one.
    """
    library = LIBRARIES[format_]
    values: dict[str, Any] = {
        "license": licence,
        "pretty_name": f"Labyrinth, for {library}",
        "task_categories": ["reinforcement-learning"],
        "tags": [library, "imitation-learning", "labyrinth", "maze", "arxiv:2509.24784"],
    }
    if repo_id is not None:
        values["source_datasets"] = [repo_id]
    if format_ == "lerobot":  # As in LeRobot's own cards: the frames, not the metadata.
        files = [{"split": split, "path": "data/*/*.parquet"}]
        values["configs"] = [{"config_name": "default", "data_files": files}]
    return values


def stage_environment(
    job: Job[PublishStageOptions], folder: Path, commit: str, manifest: Manifest
) -> None:
    """Write all files of the repository of a run's environment: `env.py` and a card.

    LeRobot looks for `env.py` in a model (`lerobot.envs.utils._download_hub_file` of
    https://pypi.org/project/lerobot/, 0.4.4 to 0.6.1), and runs it if its user allows that.

    Args:
        job: The dataset.
        folder: The folder to write them in.
        commit: The commit of the dataset on the Hub.
        manifest: The manifest of that dataset.
    """
    dataset, _ = job.options.dataset_on_hub
    splits = [split for split in manifest.config.splits if split not in SPLITS.not_evaluated]
    # As Python literals, so that no text from the Hub can become code.
    values = {"dataset": repr(dataset), "config": repr(job.dataset.name)}
    File(folder / "env.py").write_text(fill("env.txt", **values, commit=repr(commit)))
    card = fill(
        "environment.md",
        name=job.options.publish.env,
        dataset=dataset,
        config=job.dataset.name,
        commit=commit,
        splits=", ".join(f"`{split}`" for split in splits),
        code=code(),
        citation=citation(),
    )
    File(folder / "README.md").write_text(card)
