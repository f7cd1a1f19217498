"""What the Hub finds wrong with the YAML at the top of a README.md (`/api/validate-yaml`).

Rules: https://huggingface.co/docs/hub/datasets-manual-configuration, the metadata specification
https://github.com/huggingface/hub-docs/blob/main/datasetcard.md, and for Spaces
https://huggingface.co/docs/hub/spaces-config-reference.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import yaml

FRONT_MATTER = re.compile(r"\A\s*---[ \t]*\r?\n(.*?)^---[ \t]*\r?$", re.DOTALL | re.MULTILINE)
LISTS_OF_WORDS = (
    *("license", "language", "tags", "task_categories", "size_categories", "datasets"),
    *("annotations_creators", "source_datasets"),
)
SPLIT = re.compile(r"\w+(\.\w+)*")
SDKS = ("gradio", "docker", "static")
COLOURS = ("red", "yellow", "green", "blue", "indigo", "purple", "pink", "gray")
LONGEST_DESCRIPTION = 60


def read_front_matter(readme: str) -> Any:
    """Return the YAML at the top of a README.md, None if there is none.

    Raises:
        yaml.YAMLError: It is not YAML.
    """
    match = FRONT_MATTER.match(readme)
    return yaml.safe_load(match[1]) if match else None


def errors_of(readme: str, kind: str) -> list[str]:
    """Return what the Hub finds wrong with the card of a repository."""
    try:
        metadata = read_front_matter(readme)
        errors = [*_errors(metadata or {}), *(_space(metadata) if kind == "space" else ())]
    except (yaml.YAMLError, AttributeError, LookupError, TypeError) as error:
        errors = [" ".join(str(error).split())]
    return [f"YAML Metadata Error: {error}" for error in errors]


def _errors(metadata: dict[str, Any]) -> Iterator[str]:
    for name in LISTS_OF_WORDS:
        value = metadata.get(name, [])
        words = value if isinstance(value, list) else [value]
        if not all(isinstance(word, str) for word in words):
            yield f'"{name}" must be a string or a list of strings'
    for file in (file for each in metadata.get("configs", []) for file in each["data_files"]):
        if not SPLIT.fullmatch(file["split"]):
            yield f'"configs.data_files.split" must match {SPLIT.pattern}, not {file["split"]!r}'


def _space(metadata: dict[str, Any]) -> Iterator[str]:
    if metadata.get("sdk") not in SDKS:
        yield f'"sdk" must be one of {", ".join(SDKS)}'
    for name in ("colorFrom", "colorTo"):
        if metadata.get(name, COLOURS[0]) not in COLOURS:
            yield f'"{name}" must be one of {", ".join(COLOURS)}'
    if len(metadata.get("short_description", "")) > LONGEST_DESCRIPTION:
        yield f'"short_description" must have at most {LONGEST_DESCRIPTION} characters'
