"""The configs in a folder of datasets, and the front matter of its README.md that lists them.

`load_dataset` reads configs and splits from the front matter. A dataset is a config, its table of
labyrinths another one, and each of its companions one more: stages write companions beside a
dataset, about its labyrinths. A companion of `5x5` lies in a folder of its own, such as
`5x5-questions`, with a manifest in the format of a dataset's. Each of its shards is about the
dataset's shard of the same name, and has that shard's fingerprint. The wing that writes a companion
declares it as the `COMPANION` of its module `companion`; card, release and validation learn of it
here.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module, resources
from itertools import chain
from pathlib import Path
from string import Template
from typing import Any

import yaml

from labyrinth_core.data import (
    COLUMNS,
    SPLITS,
    TABLE_COLUMNS,
    Columns,
    Dataset,
    DatasetConfig,
    Manifest,
    Shard,
)
from labyrinth_core.errors import MALFORMED, DatasetError, one_line, printable_line
from labyrinth_core.folders import WholeFolder
from labyrinth_core.storage import AnyPath, File
from pipeline.machinery import say

DEFAULT_CONFIG = "5x5"
"""The default config of a folder that has it."""

TABLE_SPLIT = "labyrinths"
"""The split name of the table of labyrinths: the Hub needs one, but its rows are of all splits."""

LICENCE = "mit"
"""The default licence of a dataset, as the Hub spells it."""

MOST_TEXT, MOST_FRONT = 1 << 24, 1 << 18
"""The most characters of a README.md and of its front matter, which PyYAML reads in 3 s."""
MOST_VALUES, DEEPEST, LONGEST_NUMBER = 50_000, 20, 100
"""The most values of a front matter, with its aliases written out; the most levels of nesting; and
the most characters of a number or date."""

_FENCE = "---\n"
BEGIN = "<!-- labyrinth-datasets: from here to the end mark this text is generated -->"
END = "<!-- labyrinth-datasets: end of the generated text; yours may stand around it -->"
"""The end of the generated text; text that a person writes outside the marks is kept."""


@dataclass(frozen=True)
class Companion:
    """The declaration of a kind of companion."""

    suffix: str
    """What follows the name of the dataset's config, such as `questions`."""
    columns: Columns
    splits: Callable[[DatasetConfig], tuple[str, ...]]
    """Returns the splits of a dataset that the companion is about."""
    row: str
    """What a row stands for, for Croissant."""
    problems: Callable[[Dataset, Dataset, int], list[str]]
    """Returns what is wrong with a companion, one line for each problem, given the dataset, the
    companion, and the number of processes."""
    section: Callable[[Mapping[str, Manifest], str, str | None], str]
    """Returns the card's section on the companions, given their manifests by config, the name of
    the dataset on the Hub, and the version of the release."""
    files: Callable[[Mapping[str, Manifest], str], dict[str, bytes]]
    """Returns files for the folder of the datasets, given the companions' manifests by config and
    the dataset's title."""
    file_names: tuple[str, ...] = ()
    """The names of those files, of which some may be left out."""

    def config(self, dataset: str) -> str:
        """Return the config name of the companion of a dataset, here and on the Hub."""
        return f"{dataset}-{self.suffix}"

    def shards(self, manifest: Manifest, config: DatasetConfig) -> list[Shard]:
        """Return the shards of a dataset that a companion with a config is about."""
        splits = self.splits(config)
        return [shard for shard in manifest.shards if shard.split in splits]

    def of(self, data_dir: AnyPath, manifest: Manifest) -> Dataset | None:
        """Return the companion of a dataset; None if missing or about other rows.

        The companion lacks shifts that the dataset got after it.
        """
        folder = data_dir / self.config(manifest.config.name)
        if not (folder / Manifest.FILE).is_file():
            return None
        companion = Dataset.at(folder, companion=self.suffix)
        config, rows = companion.manifest.config, self.shards(manifest, companion.manifest.config)
        same = [(shard.path, shard.fingerprint) for shard in companion.manifest.shards] == [
            (shard.path, shard.fingerprint) for shard in rows
        ]
        return (
            companion if same and config == replace(manifest.config, shifts=config.shifts) else None
        )

    def beside(self, manifests: Sequence[Manifest]) -> dict[str, Manifest]:
        """Return the manifests of the companions of datasets, by the names of their configs."""
        return {
            self.config(manifest.config.name): manifest.companions[self.suffix]
            for manifest in manifests
            if self.suffix in manifest.companions
        }

    @staticmethod
    @cache
    def kinds() -> tuple[Companion, ...]:
        """Return the declared kinds of companions."""
        folder = Path(__file__).parents[1]
        wings = sorted(path.parent.name for path in folder.glob("*/companion.py"))
        return tuple(import_module(f"pipeline.{wing}.companion").COMPANION for wing in wings)


def finished(data_dir: AnyPath) -> list[Manifest]:
    """Return the manifests of all finished datasets of a folder, the smallest first."""
    folders = [file.parent for file in data_dir.glob(f"*/{Manifest.FILE}")]
    named = [folder for folder in folders if DatasetConfig.NAME.fullmatch(folder.name)]
    read_from = {folder.name: Dataset.at(folder, renamed=True).manifest for folder in named}
    manifests = []
    for folder, manifest in read_from.items():
        # A copy under another name is not a config: its files would not be where the card says.
        if manifest.config.name == folder:
            found = {kind.suffix: kind.of(data_dir, manifest) for kind in Companion.kinds()}
            made = {suffix: each.manifest for suffix, each in found.items() if each is not None}
            manifests.append(replace(manifest, companions=made))
    return sorted(manifests, key=lambda m: (m.config.height, m.config.width, str(m.config.task)))


def without_manifest(data_dir: AnyPath) -> list[AnyPath]:
    """Return the folders of a local folder that hold a dataset whose manifest is missing.

    In a store, a dataset that is being built looks the same.
    """
    if not WholeFolder.of(data_dir, Manifest.FILE).is_replaced_at_once:
        return []
    folders: list[AnyPath] = [file.parent for file in data_dir.glob(f"*/{Manifest.TABLE}")]
    named = [folder for folder in folders if DatasetConfig.NAME.fullmatch(folder.name)]
    lacking = [folder for folder in named if not (folder / Manifest.FILE).exists()]
    return sorted(lacking, key=str)


def table_config(config: str) -> str:
    """Return the name that the table of labyrinths of a config has on the Hub."""
    return f"{config}-{TABLE_SPLIT}"


def default_config(manifests: list[Manifest]) -> str:
    """Return the name of the default config: `DEFAULT_CONFIG` if present, else the first."""
    names = [manifest.config.name for manifest in manifests]
    return DEFAULT_CONFIG if DEFAULT_CONFIG in names else names[0]


def update(data_dir: AnyPath) -> None:
    """Write the front matter for all finished datasets of a folder; keep the text below it.

    Configs that it no longer lists are printed.

    Raises:
        DatasetError: The folder has a README.md that is not a dataset's.
    """
    path = data_dir / "README.md"
    values, text = read(path)
    manifests = finished(data_dir)
    wanted = values | described(manifests)
    if wanted == values and text:
        return  # Not a byte of a card changes when nothing is new.
    listed = {config["config_name"] for config in wanted["configs"]}
    names = [config["config_name"] for config in values.get("configs", [])]
    if gone := [name for name in names if name not in listed]:
        reason = "missing, or about other rows (the stage that made it makes it again)"
        say(f"{path} no longer lists {', '.join(gone)}: {reason}.")
    text = text or with_generated("", _text(manifests))
    File(path).write_text(with_values(wanted, text))


def splits_of(manifests: list[Manifest]) -> list[str]:
    """Return the names of the splits that at least one dataset has, in order."""
    held = {split for manifest in manifests for split in manifest.config.splits}
    return [split for split in SPLITS if split in held]


def with_values(values: dict[str, Any], text: str) -> str:
    """Return the content of a README.md with a front matter, as the Hub's client would write it."""
    front = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=math.inf)
    return f"{_FENCE}{front}{_FENCE}{text}"


def described(manifests: list[Manifest]) -> dict[str, Any]:
    """Return the values from which `load_dataset` reads configs, splits, features and counts."""
    default = default_config(manifests)
    configs, infos = [], []

    def add(manifest: Manifest, name: str, columns: Columns, splits: Sequence[str]) -> None:
        patterns = {split: shard_pattern(manifest, split, name) for split in splits}
        own = {"default": True} if name == default else {}
        configs.append(_config(name, patterns) | own)
        shards = {split: manifest.of(split) for split in splits}
        counts = {
            split: (sum(shard.bytes for shard in each), sum(shard.rows for shard in each))
            for split, each in shards.items()
        }
        infos.append(_info(name, columns, counts))

    for manifest in manifests:
        add(manifest, manifest.config.name, COLUMNS, manifest.config.splits)
    for manifest in manifests:
        name = table_config(manifest.config.name)
        configs.append(_config(name, {TABLE_SPLIT: f"{manifest.config.name}/{Manifest.TABLE}"}))
        rows = sum(shard.labyrinths for shard in manifest.shards)
        infos.append(_info(name, TABLE_COLUMNS, {TABLE_SPLIT: (manifest.table.bytes, rows)}))
    for kind in Companion.kinds():
        for name, companion in kind.beside(manifests).items():
            add(companion, name, kind.columns, kind.splits(companion.config))
    return {"configs": configs, "dataset_info": infos}


def _config(name: str, patterns: Mapping[str, str]) -> dict[str, Any]:
    """Return where the files of a config are, given the pattern of each split."""
    files = [{"split": split, "path": pattern} for split, pattern in patterns.items()]
    return {"config_name": name, "data_files": files}


def _info(name: str, columns: Columns, splits: Mapping[str, tuple[int, int]]) -> dict[str, Any]:
    """Return the information on a config, given the bytes and the rows of each split."""
    size = sum(count for count, _ in splits.values())
    return {
        "config_name": name,
        "features": [{"name": column.name} | _kind(column.feature) for column in columns],
        "splits": [
            {"name": split, "num_bytes": count, "num_examples": rows}
            for split, (count, rows) in splits.items()
        ],
        "download_size": size,
        "dataset_size": size,
    }


def _kind(feature: dict[str, Any]) -> dict[str, Any]:
    """Return a feature in the form of the front matter."""
    if feature["_type"] == "ClassLabel":
        names = {str(number): name for number, name in enumerate(feature["names"])}
        return {"dtype": {"class_label": {"names": names}}}
    if feature["_type"] == "List":
        return {"list": feature["feature"]["dtype"]}
    return {"dtype": feature.get("dtype", feature["_type"].lower())}


def shard_pattern(manifest: Manifest, split: str, name: str) -> str:
    """Return a glob pattern that matches a split's shards, but no file left by another build.

    Args:
        manifest: The manifest of the shards.
        split: The split.
        name: The name of the shards' config and folder: the dataset's, or a companion's.
    """
    first = manifest.of(split)[0].path
    return f"{name}/{split}-*-of-{first.rpartition('-of-')[2]}"


def with_generated(text: str, generated: str) -> str:
    """Return the text of a README.md with its generated part replaced.

    Args:
        text: The text so far; if it has no marks, a person wrote it and it comes last.
        generated: The new part, without marks.

    Raises:
        DatasetError: One of the two marks is missing, or they are in the wrong order.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if bool(begin) != bool(end) or (not begin and END in text):
        raise DatasetError("README.md: one of the two marks of the generated text is missing")
    if not begin:
        before, after = "\n", f"\n\n{text.strip()}\n" if text.strip() else "\n"
    return f"{before}{BEGIN}\n\n{generated.strip()}\n\n{END}{after}"


def read(path: AnyPath) -> tuple[dict[str, Any], str]:
    """Return the front matter of a README.md and the text below it; defaults without a file.

    Raises:
        DatasetError: The README.md is not a dataset's, or its front matter cannot be read.
    """
    try:
        values, text = read_any(path)
    except FileNotFoundError as error:
        if path.is_symlink():
            raise DatasetError(f"{path} is a link that leads nowhere: remove it") from error
        return {"license": LICENCE, "pretty_name": "Labyrinth"}, ""
    except DatasetError as error:
        raise DatasetError(f"{error}: correct it, or choose another data_dir") from error
    if not isinstance(values, dict) or not _are_ours(values.get("configs")):
        raise DatasetError(f"{path} is not the README of a dataset: choose another data_dir")
    return values, text


def read_any(path: AnyPath) -> tuple[Any, str]:
    """Return the values of the front matter of anyone's README.md, None without one, and the text.

    Raises:
        DatasetError: It cannot be read, or exceeds a limit.
        FileNotFoundError: There is no README.md.
    """
    with io.TextIOWrapper(path.open("rb"), encoding="utf-8") as file:
        try:
            content = file.read(MOST_TEXT + 1)
        except UnicodeDecodeError as error:
            raise DatasetError(f"{path} is not UTF-8 text") from error
    if len(content) > MOST_TEXT:
        raise DatasetError(f"{path} has over {MOST_TEXT:,} characters")
    front, closing, text = content.removeprefix(_FENCE).partition("\n" + _FENCE)
    if not (content.startswith(_FENCE) and closing):
        return None, content
    try:
        return _parsed(front), text
    except ValueError as error:
        told = f"its front matter cannot be read ({one_line(error):.200})"
        raise DatasetError(f"{path}: {told}") from error


def _from_yaml(call: Callable[..., Any], *arguments: Any) -> Any:
    """Return the result of a call of PyYAML; raise ValueError for a text that it cannot read."""
    try:
        return call(*arguments)
    except (*MALFORMED, ArithmeticError, yaml.YAMLError) as error:  # PyYAML raises all of these.
        told = isinstance(error, (ValueError, yaml.YAMLError))
        reason = one_line(error) if told else "a value does not fit its type, or nests too deep"
        if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark:
            line = error.problem_mark.line + 2  # Below the fence, counted from 1.
            reason = f"line {line}: {' '.join(str(error.problem).split())}"
        raise ValueError(reason) from error


def _parsed(front: str) -> Any:
    """Return the values of a front matter; its limits are checked before a value is made.

    Raises:
        ValueError: It exceeds the limits, or is not YAML.
    """
    if len(front) > MOST_FRONT:
        raise ValueError(f"{len(front):,} characters, more than {MOST_FRONT:,}")
    loader = _from_yaml(yaml.SafeLoader, front)  # It refuses control characters.
    root = _from_yaml(loader.get_single_node)
    values = 0
    nodes = [] if root is None else [(root, 1)]
    while nodes:
        node, depth = nodes.pop()
        values += 1
        if values > MOST_VALUES or depth > DEEPEST:
            raise ValueError(f"more than {MOST_VALUES:,} values, or nested deeper than {DEEPEST}")
        if isinstance(node, yaml.ScalarNode):
            node.value.encode()  # Raises for a surrogate, which no file can hold.
            if node.tag != "tag:yaml.org,2002:str" and len(node.value) > LONGEST_NUMBER:
                raise ValueError(f"a number of more than {LONGEST_NUMBER} characters")
        else:
            is_mapping = isinstance(node, yaml.MappingNode)
            inner = chain.from_iterable(node.value) if is_mapping else node.value
            nodes += [(each, depth + 1) for each in inner]
    return None if root is None else _from_yaml(loader.construct_document, root)


def _are_ours(configs: object) -> bool:
    """Return whether a front matter has a list of configs, all named like ours."""
    if not isinstance(configs, list):
        return False
    names = [str(each.get("config_name")) if isinstance(each, dict) else "" for each in configs]
    suffixes = "|".join([TABLE_SPLIT, *(kind.suffix for kind in Companion.kinds())])
    ours = re.compile(f"(?:{DatasetConfig.NAME.pattern})(-({suffixes}))?", re.ASCII)
    return all(map(ours.fullmatch, names))


def licence_of(values: Mapping[str, Any]) -> str:
    """Return the licence in a front matter, in one line; several are joined by commas."""
    licence = values.get("license") or LICENCE
    names = licence if isinstance(licence, list) else [licence]
    return printable_line(", ".join(map(str, names)))


def _text(manifests: list[Manifest]) -> str:
    """Return the card that a build writes, in brief; the stage `card` writes all of it."""
    brief = resources.files(__package__).joinpath("card_in_brief.md").read_text(encoding="utf-8")
    return Template(brief).substitute(
        default=default_config(manifests),
        columns="\n".join(f"| `{column.name}` | {column.meaning} |" for column in COLUMNS),
        splits="\n".join(f"| `{s}` | {SPLITS[s].meaning} |" for s in splits_of(manifests)),
    )
