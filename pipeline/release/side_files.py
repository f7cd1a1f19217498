"""The small files beside a card: CITATION.cff, eval.yaml and CHANGELOG.md."""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import yaml

from labyrinth_core.data.manifest import Manifest
from labyrinth_core.evaluation.questions import question_splits
from labyrinth_core.version import DEVELOPERS, __version__
from pipeline.inspection import front_matter
from pipeline.release.provenance import Release
from pipeline.release.texts import fill, read

UNRELEASED = "Unreleased"


def _yaml(values: dict[str, Any]) -> str:
    return yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=100)


def citation_file(release: Release) -> str:
    """Return the CITATION.cff of a dataset (https://citation-file-format.github.io, 1.2.0)."""
    fields = {"version": release.version or "", "url": release.url, "software": __version__}
    values = yaml.safe_load(fill("CITATION.cff", developers=DEVELOPERS, **fields))
    if release.licence != front_matter.LICENCE:  # Its SPDX name is unknown, only the Hub's.
        del values["license"], values["license-url"]
    if not release.repo_id:
        del values["url"]
    return _yaml({name: value for name, value in values.items() if value is not None})


def eval_file(manifests: Sequence[Manifest], name: str) -> str | None:
    """Return the eval.yaml of a folder of datasets, or None if no dataset has questions.

    The form is from https://huggingface.co/docs/hub/eval-results, "Registering a Benchmark":
    inspect-ai runs one task per split with questions as text, and one with pictures.

    Args:
        manifests: The manifests of all configs.
        name: The name of the benchmark.
    """
    asked = front_matter.asked(manifests)
    if not asked:
        return None
    values = yaml.safe_load(read("eval.yaml"))
    each, forms = values.pop("each"), values["tasks"]
    values["tasks"] = [
        {"id": f"{config}{form}-{split}", "config": config, "split": split}
        # A copy, or the file would refer to the first task in all others.
        | deepcopy(own | each)
        for config, questions in asked.items()
        for form, own in forms.items()
        for split in question_splits(questions.config)
    ]
    return _yaml({"name": name} | values)


def changelog(text: str, manifests: Sequence[Manifest], version: str | None) -> str:
    """Return the changelog with an entry for the datasets of a folder.

    The entry "Unreleased" changes with the data, and becomes the entry of the next version.

    Args:
        text: The changelog so far; empty if there is no file.
        manifests: The manifests of all datasets of the folder.
        version: The version of the release, if it is one.
    """
    title, *parts = re.split(r"^## ", text, flags=re.MULTILINE)
    entries = {heading: body.strip() for heading, _, body in (p.partition("\n") for p in parts)}
    lines = "\n".join(
        f"- `{manifest.config.name}`: {sum(shard.rows for shard in manifest.shards):,} rows, "
        f"fingerprint `{manifest.fingerprint}`"
        for manifest in manifests
    )
    if version is None and lines == next(iter(entries.values()), ""):
        return text
    heading = version or UNRELEASED
    older = {name: body for name, body in entries.items() if name not in (heading, UNRELEASED)}
    written = (f"## {name}\n\n{body}" for name, body in {heading: lines, **older}.items())
    return "\n\n".join([title.strip() or read("changelog.md").strip(), *written]) + "\n"
