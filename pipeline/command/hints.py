"""Suggested next steps: command lines to paste into a shell, bash or zsh."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

from pipeline.command.composed import GROUPS, KINDS, SHARED
from pipeline.command.stages import STAGES
from pipeline.config import as_typed


def next_command(
    options: Any, added: str, purpose: str, overrides: Iterable[str], flags: Iterable[str] = ()
) -> str:
    """Return the line that suggests a command, without the options that its stages do not use.

    Args:
        options: All options of the command that has run.
        added: The options of the next command: `stages=` with names, then others.
        purpose: What it is for.
        overrides: The overrides of the command line, each as `name=value`.
        flags: The flags of the command line that choose the configuration.
    """
    first, *more = added.split()
    # The wing of a stage may have been taken out.
    stages = [each for each in first.removeprefix("stages=").split(",") if each in STAGES]
    if not stages:
        return ""
    more.insert(0, f"stages=[{','.join(stages)}]" if len(stages) > 1 else f"stages={stages[0]}")
    used = {each.name for stage in stages for each in fields(STAGES[stage].options)} | SHARED
    used -= {"overwrite", *(each.partition("=")[0] for each in more)}
    names = {each: each.lstrip("+~").partition("=")[0] for each in overrides}
    kept = [
        _resolved(each, name, options)
        for each, name in names.items()
        if name.partition(".")[0] in used or name.partition(".")[0] not in GROUPS
    ]
    if not any(each.startswith("size=") for each in kept):
        kept = [as_typed("size", options.size), *kept]
    script = Path(sys.argv[0]).name == "run.py"
    program = f"python {shlex.quote(sys.argv[0])}" if script else "labyrinth-datasets"
    words = [program, *map(shlex.quote, flags), *kept, *map(shlex.quote, more)]
    return f"Next, to {purpose}: {' '.join(words)}"


def _resolved(override: str, name: str, options: Any) -> str:
    """Return an override as typed, with its option's value, in which no reference is left."""
    group, _, key = name.rpartition(".")
    if group == "method" and key in options.method:
        return as_typed(name, options.method[key])
    if name == "method" or name not in KINDS:
        return shlex.quote(override)
    return as_typed(name, getattr(getattr(options, group) if group else options, key))
