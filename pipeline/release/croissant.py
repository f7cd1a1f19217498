"""The Croissant description of a dataset: JSON-LD that machines read, with responsible-AI fields.

Croissant 1.1 (https://docs.mlcommons.org/croissant/docs/croissant-spec-1.1.html) and its RAI
vocabulary 1.0 (https://docs.mlcommons.org/croissant/docs/croissant-rai-spec.html). The description
that the Hub generates lacks those fields and the hashes. `texts/croissant.json` is the template, in
parts: `@context` is the one that mlcroissant 1.1 expects, with the provenance vocabulary;
`datePublished` is the fixed day of this data format (`manifest.FORMAT` 2), so that the same data
give the same file; the `sha256` of the repository is an issue of Croissant's, as it has none.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from string import Template
from typing import Any, NamedTuple

from labyrinth_core.data import COLUMNS, SPLITS, TABLE_COLUMNS, Columns, Manifest
from labyrinth_core.version import DEVELOPERS
from pipeline.inspection import Companion, DatasetStatistics, front_matter
from pipeline.release.readme import limits
from pipeline.release.texts import Release, citation, command, paragraph, read

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


class _Config(NamedTuple):
    """A config with splits: a dataset, or a companion such as questions."""

    manifest: Manifest
    columns: Columns
    splits: Sequence[str]
    row: str
    """What a row stands for."""


def croissant(datasets: Sequence[DatasetStatistics], release: Release) -> str:
    """Return the content of the croissant.json of a folder of datasets."""
    parts = json.loads(read("croissant.json"))
    manifests = [dataset.manifest for dataset in datasets]
    configs = {
        m.config.name: _Config(m, COLUMNS, m.config.splits, "state of an episode")
        for m in manifests
    }
    extra = {
        name: _Config(made, kind.columns, kind.splits(made.config), kind.row)
        for kind in Companion.kinds()
        for name, made in kind.beside(manifests).items()
    }
    is_fixed = any(manifest.config.goals == "fixed" for manifest in manifests)
    mit = release.licence == front_matter.LICENCE
    content = _filled(
        parts["dataset"],
        url=release.url,
        licence="https://spdx.org/licenses/MIT.html" if mit else release.licence,
        version=release.version or "0.0.0-unreleased",
        citation=citation().partition("\n\n")[0],
        developers=DEVELOPERS,
        corners=paragraph("corners") if is_fixed else None,
        limits=limits(datasets),
        activities=[
            _filled(parts["activity"], software=_software(each), command=command(each.config))
            for each in manifests
        ],
        distribution=[*_distribution(parts, configs | extra, release)],
        records=[
            *(_rows(parts, *each) for each in configs.items()),
            *(_labyrinths(parts, name) for name in configs),
            *(_rows(parts, *each) for each in extra.items()),
        ],
    )
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def _filled(part: Any, **fields: Any) -> Any:
    """Return a part of the template with its fields filled in; what is None is left out."""
    if isinstance(part, dict):
        filled = {name: _filled(value, **fields) for name, value in part.items()}
        return {name: value for name, value in filled.items() if value is not None}
    if isinstance(part, list):
        return [each for value in part if (each := _filled(value, **fields)) is not None]
    if isinstance(part, str) and part[:1] == "$" and part[1:] in fields:
        return fields[part[1:]]  # It may be of any type.
    return Template(part).substitute(fields) if isinstance(part, str) else part


def _software(manifest: Manifest) -> str:
    version = manifest.versions.get("labyrinth-datasets", "")
    return f"{manifest.config.name}, labyrinth-datasets {version}".strip()


def _distribution(
    parts: Mapping[str, Any],
    configs: Mapping[str, _Config],
    release: Release,
) -> Iterator[dict[str, Any]]:
    """Yield the repository and the files of configs."""
    within = None  # For files beside croissant.json.
    if release.repo_id:
        within = {"@id": REPOSITORY}
        yield _filled(parts["repository"], repository=REPOSITORY, url=release.url)
    for name, (manifest, *_) in configs.items():
        splits = dict.fromkeys(shard.split for shard in manifest.shards)
        patterns = [front_matter.shard_pattern(manifest, split, name) for split in splits]
        yield _filled(parts["files"], config=name, patterns=patterns, within=within)
        files = {shard.path: (shard.bytes, shard.sha256) for shard in manifest.shards}
        if manifest.labyrinths is not None:
            files[Manifest.TABLE] = (manifest.labyrinths.bytes, manifest.labyrinths.sha256)
        for file, (size, digest) in files.items():
            path = f"{name}/{file}"
            yield _filled(parts["file"], path=path, size=size, sha256=digest, within=within)


def _rows(parts: Mapping[str, Any], name: str, config: _Config) -> Any:
    """Return the record set of a config with splits."""
    meanings = ", ".join(f"{split} ({SPLITS[split].meaning})" for split in config.splits)
    files = {"file_set": {"@id": f"files-of-{name}"}, "file_object": None}
    fields = [
        _filled(parts["split"], config=name, meanings=meanings),
        *_fields(parts, name, config.columns, **files),
    ]
    return _filled(parts["rows"], config=name, row=config.row, fields=fields)


def _labyrinths(parts: Mapping[str, Any], parent: str) -> Any:
    """Return the record set of the table of labyrinths of a config."""
    config, file = front_matter.table_config(parent), {"@id": f"{parent}/{Manifest.TABLE}"}
    files = {"file_set": None, "file_object": file}
    fields = list(_fields(parts, config, TABLE_COLUMNS, **files))
    return _filled(parts["labyrinths"], config=config, parent=parent, fields=fields)


def _fields(parts: Mapping[str, Any], config: str, columns: Columns, **files: Any) -> Iterator[Any]:
    """Yield the field of each column of Parquet files."""
    for column in columns:
        feature = column.feature
        is_list = feature["_type"] == "List"
        feature = feature["feature"] if is_list else feature
        yield _filled(
            parts["field"],
            config=config,
            name=column.name,
            meaning=f"{column.meaning[0].upper()}{column.meaning[1:]}",
            type=_DATA_TYPES[feature.get("dtype", feature["_type"])],
            transform={"jsonPath": "bytes"} if feature["_type"] == "Image" else None,
            is_array=True if is_list else None,
            array_shape="-1" if is_list else None,
            **files,
        )
