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

from labyrinth_core.data.columns import COLUMNS, SPLITS
from labyrinth_core.data.dataset_config import DatasetConfig
from pipeline.release.citation import paper_bibtex
from pipeline.release.limits import limits
from pipeline.release.provenance import (
    LICENCE_URL,
    PAPER_AUTHORS,
    PAPER_URL,
    UNRELEASED,
    Release,
    command,
)
from pipeline.release.statistics import DatasetStatistics

REPOSITORY = "repo"
"""The id of the repository; `mapping={"repo": folder}` makes mlcroissant read a local copy."""

_DATA_TYPES = {
    "obs": "sc:ImageObject",
    "actions": "sc:Integer",
    "rewards": "sc:Float",
    "episode_starts": "sc:Boolean",
    "info": "sc:Text",
}


def croissant(datasets: Sequence[DatasetStatistics], release: Release) -> str:
    """Return the content of croissant.json.

    Args:
        datasets: The statistics of each config of the folder.
        release: What is known of the release.
    """
    authors = [
        {"@type": "Person", "name": f"{given} {family}", "givenName": given, "familyName": family}
        for family, given in PAPER_AUTHORS
    ]
    content = {
        "@context": _context(),
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
        "license": LICENCE_URL,
        "version": release.version or UNRELEASED,
        "datePublished": release.date,
        "citeAs": paper_bibtex(),
        "creator": [{"@type": "Organization", "name": "The Labyrinth datasets developers"}],
        "citation": {"@type": "ScholarlyArticle", "url": PAPER_URL, "author": authors},
        "isAccessibleForFree": True,
        "keywords": ["imitation learning", "generalisation", "labyrinth", "reinforcement learning"],
        **_responsible_ai(datasets),
        "distribution": _distribution(datasets, release),
        "recordSet": [_record_set(dataset.manifest.config) for dataset in datasets],
    }
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def _context() -> Any:
    """Return the context of appendix 1 of the specification, with the vocabulary of provenance."""
    return json.loads(files("pipeline.release").joinpath("croissant_context.json").read_bytes())


def _responsible_ai(datasets: Sequence[DatasetStatistics]) -> dict[str, Any]:
    return {
        "rai:dataCollection": "Sampled, solved and drawn by a program; nothing was recorded from "
        "people or from the world.",
        "rai:dataCollectionType": "Software Collection",
        "rai:dataLimitations": limits(datasets),
        "rai:dataBiases": [
            "Structures are not uniform over all connected ones; see the limitations.",
            "With start and goal in fixed corners, up and right are most of the demonstrated "
            "actions.",
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
    parts: list[dict[str, Any]] = [
        {
            "@type": "cr:FileObject",
            "@id": REPOSITORY,
            "name": REPOSITORY,
            "description": "The repository of the dataset on the Hugging Face Hub.",
            "contentUrl": release.url,
            "encodingFormat": "git+https",
            # A repository has no hash of its own: https://github.com/mlcommons/croissant/issues/80
            "sha256": "https://github.com/mlcommons/croissant/issues/80",
        }
    ]
    for dataset in datasets:
        parts.append(
            {
                "@type": "cr:FileSet",
                "@id": _file_set(dataset.manifest.config),
                "name": _file_set(dataset.manifest.config),
                "description": f"The Parquet files of {dataset.name}.",
                "containedIn": {"@id": REPOSITORY},
                "encodingFormat": "application/x-parquet",
                "includes": [f"{dataset.name}/{split}-*-of-*.parquet" for split in SPLITS],
            }
        )
        parts += [
            {
                "@type": "cr:FileObject",
                "@id": f"{dataset.name}/{shard.path}",
                "name": f"{dataset.name}/{shard.path}",
                "containedIn": {"@id": REPOSITORY},
                "contentUrl": f"{dataset.name}/{shard.path}",
                "contentSize": f"{shard.bytes} B",
                "encodingFormat": "application/x-parquet",
                "sha256": shard.sha256,
            }
            for shard in dataset.manifest.shards
        ]
    return parts


def _file_set(config: DatasetConfig) -> str:
    return f"files-of-{config.name}"


def _record_set(config: DatasetConfig) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": config.name,
        "name": config.name,
        "description": f"The rows of the config {config.name}, one for each state of an episode.",
        "field": [_split_field(config), *(_field(config, column.name) for column in COLUMNS)],
    }


def _split_field(config: DatasetConfig) -> dict[str, Any]:
    splits = ", ".join(f"{split} ({meaning})" for split, meaning in SPLITS.items())
    return {
        "@type": "cr:Field",
        "@id": f"{config.name}/split",
        "name": "split",
        "description": f"The split that the row is in: {splits}.",
        "dataType": ["sc:Text", "cr:Split"],
        "source": {
            "fileSet": {"@id": _file_set(config)},
            "extract": {"fileProperty": "fullpath"},
            "transform": {"regex": rf"^.*?{config.name}/(\w+?)-\d+-of-\d+\.parquet$"},
        },
    }


def _field(config: DatasetConfig, name: str) -> dict[str, Any]:
    source: dict[str, Any] = {
        "fileSet": {"@id": _file_set(config)},
        "extract": {"column": name},
    }
    if name == "obs":
        source["transform"] = {"jsonPath": "bytes"}
    meaning = next(column.meaning for column in COLUMNS if column.name == name)
    return {
        "@type": "cr:Field",
        "@id": f"{config.name}/{name}",
        "name": name,
        "description": f"{meaning[0].upper()}{meaning[1:]}.",
        "dataType": _DATA_TYPES[name],
        "source": source,
    }
