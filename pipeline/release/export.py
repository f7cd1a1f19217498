"""The export of a dataset as a repository that the library of its format reads from the Hub.

One holds one config. LeRobot reads one dataset at the root, so that there it is one split; Minari
reads a group of datasets, whose ids begin with the name of the repository, as
`minari.storage.remotes.huggingface` of https://pypi.org/project/minari/, 0.5.4, has it.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from huggingface_hub import HfApi

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.source import local_folder
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.data.storage import write_text
from pipeline.config.errors import check, listed
from pipeline.config.export import RECORD, VERSION
from pipeline.config.run import Run
from pipeline.inspection import front_matter
from pipeline.machinery.dataset import manifest_of
from pipeline.machinery.markdown import table
from pipeline.machinery.own_files import OwnFiles, list_all
from pipeline.release.model import published_dataset
from pipeline.release.plan import LEROBOT, MINARI
from pipeline.release.provenance import code, command_lines
from pipeline.release.remote import SOURCES
from pipeline.release.texts import citation, fill, paragraph

KINDS = {"lerobot": LEROBOT, "minari": MINARI}
"""Format -> the kind of its repository."""

NAMESPACE_METADATA = "namespace_metadata.json"
"""The file by which Minari knows a group, and each group within a group."""


def loading(run: Run) -> str:
    """Return the line that loads the export of a run from the Hub, for Minari its first split."""
    options, name = run.options, run.options.publish.export
    if options.export.format == "lerobot":
        return f'LeRobotDataset("{name}")'
    owner, _, group = name.partition("/")
    split = (*options.export.splits, *run.dataset.splits)[0]
    id_ = f"{group}/{run.dataset.name}/{split}-v{VERSION}"
    return f"MINARI_REMOTE=hf://{owner} minari download {id_}"


@contextmanager
def staged_export(run: Run, api: HfApi) -> Iterator[Path]:
    """Yield a folder with all that the repository of the export of a run is to hold.

    Files of an export are links to it.

    Raises:
        ConfigError: The dataset has no such split.
        DatasetError: A split is not exported, or damaged, or of another dataset or other options.
        PublishError: The dataset is not on the Hub under the id that was given.
    """
    options = run.options
    repo_id, commit = None, None
    if options.publish.repo_id or (
        options.dataset is not None and local_folder(run.source, run.dataset.name, None) is None
    ):
        repo_id, _ = run.dataset_on_hub
        commit, manifest = published_dataset(run, api)
    else:
        manifest = manifest_of(run)
    splits = tuple(dict.fromkeys(options.export.splits)) or manifest.config.splits
    unknown = [name for name in splits if name not in manifest.config.splits]
    allowed = listed(manifest.config.splits)
    check(not unknown, f"export.splits={listed(options.export.splits)}: choose from {allowed}")
    with tempfile.TemporaryDirectory(prefix="labyrinth-export-") as temporary:
        folder = Path(temporary)
        records = {}
        for split in splits:
            place = folder
            if options.export.format == "minari":
                place = folder / run.dataset.name / f"{split}-v{VERSION}"
            records[split] = _linked(run, manifest, split, place)
        if options.export.format == "minari":
            _group(folder, run, splits)
        write_text(folder / "README.md", _card(run, manifest, records, repo_id, commit))
        list_all(folder)
        yield folder


def _linked(run: Run, manifest: Manifest, split: str, place: Path) -> dict[str, Any]:
    """Link the files of the export of a split into a folder, and return its record.

    Raises:
        DatasetError: There is none, or it is damaged, or of another dataset or other options.
    """
    source, size = run.export_folder / f"{split}-v{VERSION}", run.options.export.image_size
    own = OwnFiles.read(source, always=RECORD)
    if not own.hashes or not all(own.has(name) for name, _ in own.hashes):
        raise DatasetError(f"{source} holds no whole export: stages=export makes it")
    record: dict[str, Any] = json.loads((source / RECORD).read_bytes())
    if (record["fingerprint"], record["image_size"]) != (manifest.fingerprint, size):
        raise DatasetError(
            f"{source} is an export of another dataset, or with other options: stages=export "
            "overwrite=true replaces it"
        )
    for name, _ in own.hashes:
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).symlink_to((source / name).absolute())
    return record


def _group(folder: Path, run: Run, splits: Sequence[str]) -> None:
    """Make Minari's group of the exports in a folder: its metadata, and the ids of its datasets."""
    group = run.options.publish.export.rpartition("/")[2]
    names = {split: f"{run.dataset.name}/{split}-v{VERSION}" for split in splits}
    ids = [f"{group}/{name}" for name in names.values()]
    for id_, name in zip(ids, names.values(), strict=True):
        path = folder / name / "data" / "metadata.json"
        content = json.loads(path.read_bytes()) | {"dataset_id": id_}
        path.unlink()  # The link, and not what it leads to.
        write_text(path, json.dumps(content))
    held = {"datasets": ids, "namespaces": [f"{group}/{run.dataset.name}"]}
    write_text(folder / NAMESPACE_METADATA, json.dumps(held, indent=1) + "\n")
    write_text(folder / run.dataset.name / NAMESPACE_METADATA, "{}\n")


def _card(
    run: Run,
    manifest: Manifest,
    records: Mapping[str, Mapping[str, Any]],
    repo_id: str | None,
    commit: str | None,
) -> str:
    """Return the README.md, a pure function of the exports and of the release."""
    options, first = run.options, next(iter(records.values()))
    name, format_ = options.publish.export, options.export.format
    library = KINDS[format_].name
    owner, _, group = name.partition("/")
    split = next(iter(records))
    values = {
        "license": first["licence"],
        "pretty_name": f"Labyrinth, for {library}",
        "task_categories": ["reinforcement-learning"],
        "tags": [library, "imitation-learning", "labyrinth", "maze", "arxiv:2509.24784"],
    }
    if format_ == "lerobot":  # As LeRobot's own cards have it: the frames, and not the metadata.
        files = [{"split": "train", "path": "data/*/*.parquet"}]
        values["configs"] = [{"config_name": "default", "data_files": files}]
    origin = ""
    if repo_id is not None:
        values[SOURCES] = [repo_id]
        origin = paragraph("export_origin", dataset=repo_id, commit=commit) + "\n\n"
    rows = [
        (f"`{split}`", SPLITS[split].meaning, f"{each['episodes']:,}", f"{each['rows']:,}")
        for split, each in records.items()
    ]
    text = fill(
        "export.md",
        library=library,
        config=run.dataset.name,
        size=first["image_size"],
        splits=table(("split", "holds", "episodes", "states"), rows, "llrr"),
        use=fill(
            f"{format_}.md",
            name=name,
            owner=owner,
            id=f"{group}/{run.dataset.name}/{split}-v{VERSION}",
        ).strip(),
        origin=origin,
        command=command_lines(manifest.config),
        fingerprint=manifest.fingerprint,
        code=code(),
        citation=citation(),
    )
    return front_matter.with_values(values, text)
