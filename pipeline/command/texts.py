"""Texts stay as typed: `revision=1.10` is not the number 1.1, nor `evaluation.name=true` a boolean.

Hydra reads such values as numbers or booleans. `as_given` therefore reads the options once more,
from the overrides that Hydra kept, with quotation marks around the values of options that are
texts. A sweep hands each run a value that it has read already; `QuoteSweptTexts`, a callback of
Hydra, puts the quotation marks there before.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from copy import deepcopy
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf, read_write

from pipeline.command.composed import KINDS

_WORD = re.compile(
    # A quoted value is a text already, and range(...) is a function of numbers.
    r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|\w+\([^)]*\)"""
    r"|(?P<before>(?:^|[\[({,])\s*(?:(?P<key>\w+)\s*:\s*)?)(?P<word>[\w.+-]+)(?=\s*(?:[])},]|$))",
    re.ASCII,
)
"""A one-word value in Hydra's grammar; or a quoted text or a call, which stay as they are."""


def quote_texts(override: str) -> str:
    """Return an override, `name=value`, with each text in quotes that Hydra would read otherwise.

    The declared type of the option tells which values are texts.
    """
    parts = re.fullmatch(r"(\+{0,2}([\w.]+)=)(.*)", override, re.DOTALL)
    if parts is None:
        return override
    start, name, value = parts.groups()
    parser = OverridesParser.create()

    def in_quotes(match: re.Match[str]) -> str:
        before, key, word = match["before"], match["key"], match["word"]
        kind = KINDS.get(f"{name}.{key}" if key else name)
        several, text = kind == tuple[str, ...], kind in (str, str | None)
        if word is None or not (several or text):
            return match[0]
        read = parser.parse_rule(word, "primitive")
        # OmegaConf converts a number to a text, but not in a list.
        if read is None or (str(read) == word and (text or isinstance(read, str))):
            return match[0]
        return f'{before}"{word}"'

    # Inside choice(), Hydra strips the quotation marks and reads a number after all.
    return start + _WORD.sub(in_quotes, re.sub(r"^choice\((.+)\)$", r"\1", value))


def overrides_of(hydra: Any) -> list[str]:
    """Return the overrides of a run or a sweep as they were typed, from Hydra's configuration."""
    kept: Any = OmegaConf.to_container(hydra.overrides.task, resolve=False)
    return list(kept)


def as_given(config: DictConfig, overrides: Iterable[str]) -> DictConfig:
    """Return a configuration whose texts are those of its overrides, character by character.

    Args:
        config: The configuration that Hydra composed.
        overrides: The overrides that it was composed from, as Hydra kept them.
    """
    typed = [*overrides]
    quoted = [*map(quote_texts, typed)]
    if quoted == typed:
        return config
    config = deepcopy(config)
    groups = {name.partition(".")[0] for name in KINDS if "." in name}
    for each in OverridesParser.create().parse_overrides(quoted):
        name = each.key_or_group
        # `method=bc` and `export=minari` choose a file; `export={...}` has values.
        has_texts = KINDS.get(name, dict[str, Any]) != dict[str, Any] or (
            name in groups and isinstance(each.value(), dict)
        )
        if has_texts and not each.is_delete():
            OmegaConf.update(config, name, each.value(), merge=True)
    return config


class QuoteSweptTexts(Callback):
    """Quotes the texts among the overrides of a sweep, before its sweeper reads them."""

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        with read_write(config.hydra.overrides):
            config.hydra.overrides.task = [*map(quote_texts, overrides_of(config.hydra))]
