"""Write what repeats declarations: `conf/`, and the tables of options, columns and splits in pages.

    python scripts/write_options.py

The declarations in `pipeline/config/` and the `Settings` of methods have types, defaults, bounds
and meanings. `conf/config.yaml` shows the options without a stage of their own, each file of
`conf/method` the settings of a method, each of `conf/export` the options of an export. `COLUMNS`
and `SPLITS` have the meanings of columns and splits.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import Field
from pathlib import Path
from textwrap import wrap
from typing import Any

from labyrinth_core.data import COLUMNS, SPLITS, TABLE_COLUMNS
from labyrinth_core.questions import QUESTION_COLUMNS
from pipeline.command.composed import ALL, DEFAULTS, OPTIONS, SECTIONS, DatasetOptions, declared
from pipeline.command.stages import STAGES
from pipeline.config import ExportOptions, TrainingOptions
from pipeline.training.identity import find

ROOT = Path(__file__).parents[1]

MADE = "Made by scripts/write_options.py"

CONFIG = f"""\
# What a run does if the command line says nothing else. {MADE} from the declarations
# in pipeline/config/; docs/options.md lists the other options, of single stages, too.
defaults:
  - base
  - method: bc  # Its settings: conf/method/bc.yaml
  - export: null
  - _self_
"""


def value_of(default: Any) -> str:
    """Return a default as YAML has it."""
    if isinstance(default, tuple):
        return f"[{', '.join(map(str, default))}]"
    if default is None:
        return "null"
    if isinstance(default, bool):
        return str(default).lower()
    return str(default) or '""'


def lines_of(options: Iterable[tuple[str, Field[Any], Any]]) -> Iterator[str]:
    """Yield the lines of YAML for options, each with its meaning above."""
    above = ""
    for name, each, _ in options:
        group, _, key = name.rpartition(".")
        if group != above and group:
            yield f"{group}:"
        above, indent = group, "  " * bool(group)
        yield from wrap(
            each.metadata["meaning"],
            98,
            **dict.fromkeys(("initial_indent", "subsequent_indent"), f"{indent}# "),
        )
        yield f"{indent}{key}: {value_of(each.default)}"


def config() -> str:
    """Return the text of `conf/config.yaml`: all options but the method and those of groups.

    The groups of a dataset's options, such as `buckets`, are shown too.
    """
    of_dataset = {name for name, _, _ in declared(DatasetOptions)}
    options = {each[0]: each for each in declared(ALL)}
    text = CONFIG if "export" in STAGES else CONFIG.replace("  - export: null\n", "")
    for heading, names in SECTIONS.items():
        shown = [name for name in names if name in of_dataset or "." not in name]
        lines = list(lines_of(options[name] for name in shown if name != "method"))
        text += f"\n# {heading}\n\n" + "\n".join(lines) + "\n" if lines else ""
    return text


def commented(values: dict[str, Any], meanings: dict[str, str]) -> str:
    """Return lines of YAML with the meaning of each value behind it."""
    lines = [f"{name}: {value_of(value)}" for name, value in values.items()]
    width = max(map(len, lines))
    pairs = zip(lines, values, strict=True)
    return "".join(
        f"{line:{width}}  # {meanings[name]}".rstrip(" #") + "\n" for line, name in pairs
    )


def method(name: str) -> str:
    """Return the text of the file of a method in `conf/method`."""
    _, settings = find(name, {}, "default")
    meanings = {
        each: kind.metadata.get("meaning", "") for each, kind, _ in declared(type(settings))
    }
    comment = f"# {MADE} from the Settings of the module, which says what it does.\n"
    target = TrainingOptions.target_of(name)
    return f"{comment}_target_: {target}\n{commented(vars(settings), meanings)}"


def export(format_: str) -> str:
    """Return the text of the file of a format in `conf/export`."""
    meanings = {each: kind.metadata["meaning"] for each, kind, _ in declared(ExportOptions)}
    comment = f"# {MADE}: stages=export export={format_}\n"
    return comment + commented(vars(ExportOptions(format=format_)), meanings)


def tables() -> Iterator[tuple[str, str, Iterable[str]]]:
    """Yield each table of the pages that repeats declarations: page, header, rows."""
    options = (
        f"| `{name}` | {DEFAULTS[name] and f'`{DEFAULTS[name]}`'} | {meaning} |"
        for name, meaning in OPTIONS.items()
    )
    yield "docs/options.md", "| option | default | meaning |", options
    for page, columns in (
        ("docs/make.md", COLUMNS),
        ("docs/loading.md", TABLE_COLUMNS),
        ("docs/questions.md", QUESTION_COLUMNS),
    ):
        rows = (f"| `{column.name}` | {column.meaning} |" for column in columns)
        yield page, "| column | meaning |", rows
    for page in ("README.md", "docs/make.md"):
        rows = (f"| `{name}` | {SPLITS[name].meaning} |" for name in SPLITS.base)
        yield page, "| split | contents |", rows
    shifts = (
        f"| `{name}` | {SPLITS[name].meaning} | `{SPLITS[name].parent or ''}` |".replace("``", "")
        for name in SPLITS.shifts
    )
    yield "docs/shifts.md", "| split | contents | parent |", shifts


def written() -> dict[Path, str]:
    """Return the content of each file."""
    files: dict[Path, str] = {}
    for page, header, rows in tables():
        text = files.get(ROOT / page) or (ROOT / page).read_text(encoding="utf-8")
        above, found, below = text.partition(f"{header}\n")
        assert found, f"{page} has no table {header}"
        rule = re.sub(r"[^|]+", "---", header)
        lines = "".join(f"{row}\n".replace("|  |", "| |") for row in (found.strip(), rule, *rows))
        files[ROOT / page] = above + lines + re.sub(r"\A(\|.*\n)+", "", below)
    files |= {ROOT / "conf/config.yaml": config()}
    files |= {ROOT / f"conf/method/{name}.yaml": method(name) for name in TrainingOptions.METHODS}
    formats = ExportOptions.FORMATS if "export" in STAGES else ()  # A wing, which may be taken out.
    return files | {ROOT / f"conf/export/{name}.yaml": export(name) for name in formats}


if __name__ == "__main__":
    for path, text in written().items():
        path.write_text(text, encoding="utf-8")
