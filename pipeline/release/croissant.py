"""The Croissant description of a dataset: JSON-LD that machines read, with responsible-AI fields.

Croissant 1.0 (https://docs.mlcommons.org/croissant/docs/croissant-spec.html) and its RAI vocabulary
1.0 (https://docs.mlcommons.org/croissant/docs/croissant-rai-spec.html). The Hub makes one by
itself, without those fields and without hashes.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

from labyrinth_core.data.columns import COLUMNS
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.labyrinth_table import TABLE, TABLE_COLUMNS, table_config
from labyrinth_core.data.splits import SPLITS
from pipeline.inspection.statistics import DatasetStatistics
from pipeline.machinery import front_matter
from pipeline.release.citation import paper_bibtex
from pipeline.release.limits import limits
from pipeline.release.provenance import (
    DATE,
    LICENCE_URL,
    PAPER_AUTHORS,
    PAPER_URL,
    Release,
    command,
)

REPOSITORY = "repo"
"""The id of the repository that a release is contained in; `mapping={"repo": folder}` makes
mlcroissant read a local copy of it."""

_DATA_TYPES = {
    "obs": "sc:ImageObject",
    "actions": "sc:Integer",
    "rewards": "sc:Float",
    "episode_starts": "sc:Boolean",
    "info": "sc:Text",
}

_OF_FIXED_GOALS = (
    "With start and goal in fixed corners, up and right are most of the demonstrated actions.",
)


def croissant(datasets: Sequence[DatasetStatistics], release: Release) -> str:
    """Return the content of the croissant.json of a folder of datasets."""
    authors = [
        {"@type": "Person", "name": f"{given} {family}", "givenName": given, "familyName": family}
        for family, given in PAPER_AUTHORS
    ]
    content = {
        # That of appendix 1 of the specification, with the vocabulary of provenance.
        "@context": json.loads(files(__package__).joinpath("croissant_context.json").read_bytes()),
        "@type": "sc:Dataset",
        "name": "labyrinth",
        "alternateName": "Labyrinth",
        "description": "Pictures of grid labyrinths with the actions that solve them, for "
        "imitation learning that can tell memorising from generalising: train, validation and "
        "test have no structure in common, not even as a mirror image.",
        "conformsTo": [
            "http://mlcommons.org/croissant/1.0",
            "http://mlcommons.org/croissant/RAI/1.0",
        ],
        "url": release.url,
        "license": LICENCE_URL if release.licence == front_matter.LICENCE else release.licence,
        "version": release.version or "0.0.0-unreleased",
        "datePublished": DATE,
        "citeAs": paper_bibtex(),
        "creator": [{"@type": "Organization", "name": front_matter.DEVELOPERS}],
        "citation": {"@type": "ScholarlyArticle", "url": PAPER_URL, "author": authors},
        "isAccessibleForFree": True,
        "keywords": ["imitation learning", "generalisation", "labyrinth", "reinforcement learning"],
        **_responsible_ai(datasets),
        "distribution": _distribution(datasets, release),
        "recordSet": [
            *(_record_set(dataset.manifest.config) for dataset in datasets),
            *(_table_records(d.name) for d in datasets if d.manifest.labyrinths is not None),
        ],
    }
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def _responsible_ai(datasets: Sequence[DatasetStatistics]) -> dict[str, Any]:
    return {
        "rai:dataCollection": "Sampled, solved and drawn by a program; nothing was recorded from "
        "people or from the world.",
        "rai:dataCollectionType": "Software Collection",
        "rai:dataLimitations": limits(datasets),
        "rai:dataBiases": [
            "Structures are not uniform over all connected ones; see the limitations.",
            *(_OF_FIXED_GOALS if "fixed" in {d.manifest.config.goals for d in datasets} else ()),
        ],
        "rai:personalSensitiveInformation": "None: the data are about no person.",
        "rai:dataUseCases": [
            "Training: imitation learning from pictures or from the text of a labyrinth.",
            "Testing: generalisation to structures, starts and goals that were not seen.",
            "Not for conclusions about robots, people or buildings.",
        ],
        "rai:dataSocialImpact": "A benchmark for research on learning algorithms; no use with an "
        "effect on people is known to us.",
        "rai:hasSyntheticData": True,
        "rai:dataReleaseMaintenancePlan": "A version is never changed once it is tagged; "
        "CHANGELOG.md says what a new one holds.",
        "prov:wasDerivedFrom": [{"@id": PAPER_URL, "name": "The paper that defines the benchmark"}],
        "prov:wasGeneratedBy": [
            {
                "@type": "prov:Activity",
                "name": f"{dataset.name}, labyrinth-datasets "
                f"{dataset.manifest.versions.get('labyrinth-datasets', '')}".strip(),
                "description": command(dataset.manifest.config),
            }
            for dataset in datasets
        ],
    }


def _distribution(datasets: Sequence[DatasetStatistics], release: Release) -> list[dict[str, Any]]:
    repository = {
        "@type": "cr:FileObject",
        "@id": REPOSITORY,
        "name": REPOSITORY,
        "description": "The repository of the dataset on the Hugging Face Hub.",
        "contentUrl": release.url,
        "encodingFormat": "git+https",
        # A repository has no hash of its own: https://github.com/mlcommons/croissant/issues/80
        "sha256": "https://github.com/mlcommons/croissant/issues/80",
    }
    # What is contained in nothing lies beside this file.
    within = {"containedIn": {"@id": REPOSITORY}} if release.repo_id else {}
    parts: list[dict[str, Any]] = [repository] if release.repo_id else []
    for dataset in datasets:
        parts.append(
            {
                "@type": "cr:FileSet",
                "@id": f"files-of-{dataset.name}",
                "name": f"files-of-{dataset.name}",
                "description": f"The Parquet files of {dataset.name}.",
                **within,
                "encodingFormat": "application/x-parquet",
                "includes": [
                    front_matter.shard_pattern(dataset.manifest, split)
                    for split in dataset.manifest.config.splits
                ],
            }
        )
        files = {shard.path: (shard.bytes, shard.sha256) for shard in dataset.manifest.shards}
        if dataset.manifest.labyrinths is not None:
            table = dataset.manifest.labyrinths
            files[TABLE] = (table.bytes, table.sha256)
        parts += [
            {
                "@type": "cr:FileObject",
                "@id": f"{dataset.name}/{name}",
                "name": f"{dataset.name}/{name}",
                **within,
                "contentUrl": f"{dataset.name}/{name}",
                "contentSize": f"{size} B",
                "encodingFormat": "application/x-parquet",
                "sha256": digest,
            }
            for name, (size, digest) in files.items()
        ]
    return parts


def _record_set(dataset: DatasetConfig) -> dict[str, Any]:
    config = dataset.name
    splits = ", ".join(f"{split} ({SPLITS[split].meaning})" for split in dataset.splits)
    of_split = {
        "extract": {"fileProperty": "fullpath"},
        "transform": {"regex": rf"^.*?{config}/(\w+?)-\d+-of-\d+\.parquet$"},
    }
    meaning = f"the split that the row is in: {splits}"
    files = {"fileSet": {"@id": f"files-of-{config}"}}
    fields = [_field(config, "split", meaning, ["sc:Text", "cr:Split"], files | of_split)]
    for column in COLUMNS:
        source: dict[str, Any] = files | {"extract": {"column": column.name}}
        if column.name == "obs":
            source["transform"] = {"jsonPath": "bytes"}
        fields.append(_field(config, column.name, column.meaning, _DATA_TYPES[column.name], source))
    return _records(
        config, f"The rows of the config {config}, one for each state of an episode.", fields
    )


def _table_records(config: str) -> dict[str, Any]:
    name, file = table_config(config), {"fileObject": {"@id": f"{config}/{TABLE}"}}
    fields = []
    for column in TABLE_COLUMNS:
        kind = "sc:Text" if column.feature["dtype"] == "string" else "sc:Integer"
        source = file | {"extract": {"column": column.name}}
        fields.append(_field(name, column.name, column.meaning, kind, source))
    return _records(name, f"The labyrinths of all splits of {config}, one in each row.", fields)


def _records(name: str, description: str, fields: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "description": description,
        "field": fields,
    }


def _field(
    config: str, name: str, description: str, kind: str | list[str], source: dict[str, Any]
) -> dict[str, Any]:
    return {
        "@type": "cr:Field",
        "@id": f"{config}/{name}",
        "name": name,
        "description": f"{description[0].upper()}{description[1:]}.",
        "dataType": kind,
        "source": source,
    }
