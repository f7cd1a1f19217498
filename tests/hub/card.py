"""What the Hub says about the YAML at the top of a README.md (`/api/validate-yaml`).

Rules: https://huggingface.co/docs/hub/datasets-manual-configuration and the metadata
specification https://github.com/huggingface/hub-docs/blob/main/datasetcard.md.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import yaml

FRONT_MATTER = re.compile(r"\A\s*---[ \t]*\r?\n(.*?)^---[ \t]*\r?$", re.DOTALL | re.MULTILINE)
LISTS_OF_WORDS = ("license", "language", "tags", "task_categories", "task_ids", "size_categories")
SIZE_CATEGORY = re.compile(r"n<1K|\d+[KMBT]?<n<\d+[KMBT]|n>1T")
SPLIT = re.compile(r"\w+(\.\w+)*")
SDKS = ("gradio", "docker", "static", "streamlit")
COLOURS = ("red", "yellow", "green", "blue", "indigo", "purple", "pink", "gray")
LONGEST_DESCRIPTION = 60
EMPTY = "empty or missing yaml metadata in repo card"


def read_front_matter(readme: str) -> Any:
    """Return the YAML at the top of a README.md, None if there is none.

    Raises:
        yaml.YAMLError: if it is not YAML.
    """
    match = FRONT_MATTER.match(readme)
    return yaml.safe_load(match[1]) if match else None


def validate(readme: str, kind: str) -> tuple[list[str], list[str]]:
    """Return the errors and the warnings that the Hub has for the card of a repository."""
    try:
        metadata = read_front_matter(readme)
    except yaml.YAMLError as error:
        return [f"YAML Metadata Error: {' '.join(str(error).split())}"], []
    if metadata is None:
        return [], [EMPTY]
    if not isinstance(metadata, dict):
        return ["YAML Metadata Error: metadata must be an object"], []
    errors = [*_words(metadata), *_configs(metadata), *_infos(metadata)]
    errors += _space(metadata) if kind == "space" else []
    return [f'YAML Metadata Error: "{error[0]}" {error[1]}' for error in errors], []


Errors = Iterator[tuple[str, str]]


def _space(metadata: dict[str, Any]) -> Errors:
    """Yield what is wrong by https://huggingface.co/docs/hub/spaces-config-reference."""
    if metadata.get("sdk") not in SDKS:
        yield "sdk", f"must be one of [{', '.join(SDKS)}]"
    for name in ("colorFrom", "colorTo"):
        if metadata.get(name, COLOURS[0]) not in COLOURS:
            yield name, f"must be one of [{', '.join(COLOURS)}]"
    if len(metadata.get("short_description", "")) > LONGEST_DESCRIPTION:
        yield "short_description", f"must have at most {LONGEST_DESCRIPTION} characters"
    if not isinstance(metadata.get("datasets", []), list):
        yield "datasets", "must be an array of ids"


def _words(metadata: dict[str, Any]) -> Errors:
    for name in LISTS_OF_WORDS:
        value = metadata.get(name, [])
        words = value if isinstance(value, list) else [value]
        if not all(isinstance(word, str) for word in words):
            yield name, "must be a string or a list of strings"
        elif name == "size_categories" and not all(map(SIZE_CATEGORY.fullmatch, words)):
            yield name, "must be such as 10K<n<100K"
    if not isinstance(metadata.get("pretty_name", ""), str):
        yield "pretty_name", "must be a string"


def _configs(metadata: dict[str, Any]) -> Errors:
    configs = metadata.get("configs", [])
    if not isinstance(configs, list) or not all(isinstance(config, dict) for config in configs):
        yield "configs", "must be an array of objects"
        return
    names = [config.get("config_name", "default") for config in configs]
    if len(set(map(str, names))) < len(names):
        yield "configs", "must have a different config_name each"
    if sum(config.get("default") is True for config in configs) > 1:
        yield "configs", "must have at most one default"
    for number, config in enumerate(configs):
        if not isinstance(config.get("config_name", "default"), str):
            yield f"configs[{number}].config_name", "must be a string"
        yield from _data_files(f"configs[{number}].data_files", config.get("data_files", []))


def _data_files(name: str, files: Any) -> Errors:
    for file in files if isinstance(files, list) else [files]:
        if isinstance(file, str):
            continue
        if not isinstance(file, dict) or not {"split", "path"} <= file.keys():
            yield name, "must be a path, or objects with split and path"
            continue
        if not isinstance(file["split"], str) or not SPLIT.fullmatch(file["split"]):
            yield f"{name}.split", f"must match {SPLIT.pattern}, not {file['split']!r}"
        paths = file["path"] if isinstance(file["path"], list) else [file["path"]]
        if not all(isinstance(path, str) for path in paths):
            yield f"{name}.path", "must be a string or an array of strings"


def _infos(metadata: dict[str, Any]) -> Errors:
    value = metadata.get("dataset_info", [])
    infos = value if isinstance(value, list) else [value]
    if not all(isinstance(info, dict) for info in infos):
        yield "dataset_info", "must be an object or an array of objects"
        return
    for number, info in enumerate(infos):
        name = f"dataset_info[{number}]"
        if len(infos) > 1 and not isinstance(info.get("config_name"), str):
            yield f"{name}.config_name", "must be a string"
        features = info.get("features", [])
        if not isinstance(features, list) or not all(
            isinstance(feature, dict) and isinstance(feature.get("name"), str)
            for feature in features
        ):
            yield f"{name}.features", "must be an array of objects with a name"
        splits = info.get("splits", [])
        if not isinstance(splits, list) or not all(_is_split(split) for split in splits):
            yield f"{name}.splits", "must be an array of objects with a name and counts"


def _is_split(split: Any) -> bool:
    return (
        isinstance(split, dict)
        and isinstance(split.get("name"), str)
        and all(type(split.get(count, 0)) is int for count in ("num_examples", "num_bytes"))
    )
