"""What the Hub finds wrong with the YAML at the top of a README.md (`/api/validate-yaml`).

Rules: https://huggingface.co/docs/hub/datasets-manual-configuration, and the metadata specification
https://github.com/huggingface/hub-docs/blob/main/datasetcard.md.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import yaml

FRONT_MATTER = re.compile(r"\A\s*---[ \t]*\r?\n(.*?)^---[ \t]*\r?$", re.DOTALL | re.MULTILINE)
WORDS = {
    **dict.fromkeys(("license", "language", "tags", "task_categories", "size_categories"), ".+"),
    **dict.fromkeys(("annotations_creators", "source_datasets", "datasets"), ".+"),
}
"""Key -> the form of its word, or of each of its words."""
SPLIT = r"\w+(\.\w+)*"


def read_front_matter(readme: str) -> Any:
    """Return the YAML at the top of a README.md, None if there is none.

    Raises:
        yaml.YAMLError: It is not YAML.
    """
    match = FRONT_MATTER.match(readme)
    return yaml.safe_load(match[1]) if match else None


def errors_of(readme: str) -> list[str]:
    """Return what the Hub finds wrong with the card of a repository."""
    try:
        metadata = read_front_matter(readme) or {}
        errors = [*_errors(metadata)]
    except (yaml.YAMLError, AttributeError, LookupError, TypeError) as error:
        errors = [" ".join(str(error).split())]
    return [f"YAML Metadata Error: {error}" for error in errors]


def _errors(metadata: dict[str, Any]) -> Iterator[str]:
    for name, form in WORDS.items():
        value = metadata.get(name, [])
        words = value if isinstance(value, list) else [value]
        if not all(isinstance(word, str) and re.fullmatch(form, word) for word in words):
            yield f'"{name}" must be a string or a list of strings, as {form}'
    for file in (file for each in metadata.get("configs", []) for file in each["data_files"]):
        if not re.fullmatch(SPLIT, file["split"]):
            yield f'"configs.data_files.split" must match {SPLIT}, not {file["split"]!r}'
