"""The Croissant description of a dataset: JSON-LD that machines read, with responsible-AI fields.

Croissant 1.1 (https://docs.mlcommons.org/croissant/docs/croissant-spec-1.1.html) and its RAI
vocabulary 1.0 (https://docs.mlcommons.org/croissant/docs/croissant-rai-spec.html). The description
that the Hub generates lacks those fields and the hashes. `texts/croissant.json` holds everything
that does not depend on the data: `@context` is the one that mlcroissant 1.1 expects, with the
provenance vocabulary; `datePublished` is the fixed day of this data format (`manifest.FORMAT` 2),
so that the same data give the same file.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from labyrinth_core.data.format import COLUMNS, TABLE_COLUMNS, Column
from labyrinth_core.data.manifest import TABLE, Manifest
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.version import DEVELOPERS
from pipeline.inspection import front_matter
from pipeline.inspection.companions import beside, companions
from pipeline.inspection.front_matter import table_config
from pipeline.inspection.statistics import DatasetStatistics
from pipeline.release.readme import limits
from pipeline.release.texts import Release, citation, command, read

REPOSITORY = "repo"
"""The id of the repository that contains a release; `mapping={"repo": folder}` makes
mlcroissant read a local copy of it."""

_DATA_TYPES = {
    "Image": "sc:ImageObject",
    "ClassLabel": "sc:Integer",
    "string": "sc:Text",
    "int32": "sc:Integer",
    "int64": "sc:Integer",
    "float32": "sc:Float",
    "bool": "sc:Boolean",
}
"""Type of a column's feature, as in the library `datasets` -> Croissant data type."""


def croissant(datasets: Sequence[DatasetStatistics], release: Release) -> str:
    """Return the content of the croissant.json of a folder of datasets."""
    content = json.loads(read("croissant.json"))
    manifests = [dataset.manifest for dataset in datasets]
    extra = [(kind, beside(manifests, kind)) for kind in companions()]
    held = {d.name: d.manifest for d in datasets}
    for _, own in extra:
        held |= own
    content |= {
        "url": release.url,
        "version": release.version or "0.0.0-unreleased",
        "citeAs": citation().partition("\n\n")[0],
        "creator": [{"@type": "Organization", "name": DEVELOPERS}],
        "rai:dataLimitations": limits(datasets),
        "prov:wasGeneratedBy": [
            {
                "@type": "prov:Activity",
                "name": f"{dataset.name}, labyrinth-datasets "
                f"{dataset.manifest.versions.get('labyrinth-datasets', '')}".strip(),
                "description": command(dataset.manifest.config),
            }
            for dataset in datasets
        ],
        "distribution": _distribution(held, release),
        "recordSet": [
            *(
                _split_records(d.name, COLUMNS, d.manifest.config.splits, "state of an episode")
                for d in datasets
            ),
            *(_table_records(d.name) for d in datasets),
            *(
                _split_records(name, kind.columns, kind.splits(made.config), kind.row)
                for kind, own in extra
                for name, made in own.items()
            ),
        ],
    }
    if release.licence != front_matter.LICENCE:
        content["license"] = release.licence
    if all(dataset.manifest.config.goals != "fixed" for dataset in datasets):
        del content["rai:dataBiases"][1]  # The one of start and goal in fixed corners.
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def _distribution(manifests: Mapping[str, Manifest], release: Release) -> list[dict[str, Any]]:
    """Return the repository and the files of configs, given the manifest of each."""
    parts: list[dict[str, Any]] = []
    within: dict[str, Any] = {}  # Empty for files beside croissant.json.
    if release.repo_id:
        within = {"containedIn": {"@id": REPOSITORY}}
        repository = {
            "description": "The repository of the dataset on the Hugging Face Hub.",
            "contentUrl": release.url,
            "encodingFormat": "git+https",
            # A repository has no hash of its own: https://github.com/mlcommons/croissant/issues/80
            "sha256": "https://github.com/mlcommons/croissant/issues/80",
        }
        parts.append(_part("cr:FileObject", REPOSITORY, **repository))
    form = {"encodingFormat": "application/x-parquet"}
    for name, manifest in manifests.items():
        description = f"The Parquet files of {name}."
        splits = dict.fromkeys(shard.split for shard in manifest.shards)
        includes = [front_matter.shard_pattern(manifest, split, name) for split in splits]
        files_of = f"files-of-{name}"
        values = {"description": description, **within, **form, "includes": includes}
        parts.append(_part("cr:FileSet", files_of, **values))
        files = {shard.path: (shard.bytes, shard.sha256) for shard in manifest.shards}
        if manifest.labyrinths is not None:
            files[TABLE] = (manifest.labyrinths.bytes, manifest.labyrinths.sha256)
        for file, (size, digest) in files.items():
            path = f"{name}/{file}"
            place = {**within, "contentUrl": path, "contentSize": f"{size} B"}
            parts.append(_part("cr:FileObject", path, **place, **form, sha256=digest))
    return parts


def _part(kind: str, name: str, **values: Any) -> dict[str, Any]:
    return {"@type": kind, "@id": name, "name": name, **values}


def _split_records(
    config: str, columns: Sequence[Column], splits: Sequence[str], row: str
) -> dict[str, Any]:
    """Return the record set of a config with splits.

    Args:
        config: The name of the config.
        columns: The columns of the config.
        splits: The splits of the config.
        row: What a row stands for.
    """
    meanings = ", ".join(f"{split} ({SPLITS[split].meaning})" for split in splits)
    of_split = {
        "extract": {"fileProperty": "fullpath"},
        "transform": {"regex": rf"^.*?{config}/(\w+?)-\d+-of-\d+\.parquet$"},
    }
    meaning = f"the split that the row is in: {meanings}"
    files = {"fileSet": {"@id": f"files-of-{config}"}}
    split = _field(config, "split", meaning, ["sc:Text", "cr:Split"], files | of_split)
    fields = [split, *_fields(config, columns, files)]
    description = f"The rows of the config {config}, one for each {row}."
    return _part("cr:RecordSet", config, description=description, field=fields)


def _table_records(config: str) -> dict[str, Any]:
    name, file = table_config(config), {"fileObject": {"@id": f"{config}/{TABLE}"}}
    description = f"The labyrinths of all splits of {config}, one in each row."
    fields = list(_fields(name, TABLE_COLUMNS, file))
    return _part("cr:RecordSet", name, description=description, field=fields)


def _fields(
    config: str, columns: Sequence[Column], files: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    """Yield the field of each column of Parquet files."""
    for column in columns:
        feature, lists = column.feature, {}
        if feature["_type"] == "List":
            feature, lists = feature["feature"], {"isArray": True, "arrayShape": "-1"}
        source: dict[str, Any] = files | {"extract": {"column": column.name}}
        if feature["_type"] == "Image":
            source["transform"] = {"jsonPath": "bytes"}
        kind = _DATA_TYPES[feature.get("dtype", feature["_type"])]
        yield _field(config, column.name, column.meaning, kind, source) | lists


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
