"""The command line as Hydra reads it: the schema, the text of `--help`, and errors in one line."""

from __future__ import annotations

import difflib
import re
import shlex
from functools import cache
from pathlib import Path
from textwrap import TextWrapper
from typing import Any, get_args, get_origin

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import MissingConfigException, OverrideParseException
from omegaconf import OmegaConf

from pipeline.config.errors import as_typed, check, listed
from pipeline.config.gone import instead
from pipeline.config.option import schema
from pipeline.config.run import DEFAULTS, KINDS, OPTIONS, SECTIONS, STAGES, RunConfig

HYDRA: dict[str, Any] = {"version_base": "1.3"} if hydra.__version__ < "1.4" else {}
"""The `version_base` for Hydra: 1.3 warns if it is missing, 1.4 warns if it is given."""


_HELP = """Make a dataset of labyrinths: unique, solved optimally, with pictures, in
Parquet shards. Train a policy on it.

  labyrinth-datasets size=5
  labyrinth-datasets size=5 'stages=[train,evaluate]' method=bc encoder=cnn
  labyrinth-datasets stages=results
  labyrinth-datasets size=4x6 task=key_and_door labyrinths=1000 workers=2
  labyrinth-datasets -m size=3,4,5

Options, each as name=value, with the default in brackets at the end; a list of
several is '[a,b]', and null stands for no value:

{options}
--cfg job prints the values that a command line gives; --hydra-help, the flags
of Hydra itself.
"""


@cache
def register(scratch: Path = Path()) -> None:
    """Register with Hydra the schema, the text of `--help` and the output folder of a sweep.

    Args:
        scratch: The output folder of a sweep, unless the user sets `hydra.sweep.dir`.
    """
    store = ConfigStore.instance()
    place = str(scratch).replace("${", "\\${")  # Not an interpolation.
    store.store(name="scratch", package="hydra.sweep", node={"dir": place})
    node = OmegaConf.structured(schema(RunConfig))
    OmegaConf.set_struct(node.method, False)  # Each method has settings of its own.
    store.store(name="schema", node=node)
    width = max(map(len, OPTIONS))
    wrapper = TextWrapper(80, subsequent_indent=" " * (width + 4), break_on_hyphens=False)
    lines = []
    for heading, options in SECTIONS.items():
        lines.append(f"{heading}:")
        for name, meaning in options.items():
            default = f" [{DEFAULTS[name]}]" if DEFAULTS[name] else ""
            lines.append(wrapper.fill(f"  {name:{width}}  {meaning}{default}"))
        lines.append("")
    help_text = _HELP.format(options="\n".join(lines))
    store.store(group="hydra/help", name="options", node={"template": help_text})


_WORD = re.compile(
    # A quoted value is a text already, and range(...) is a function of numbers.
    r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|\w+\([^)]*\)"""
    r"|(?P<before>(?:^|[\[({,])\s*(?:(?P<key>\w+)\s*:\s*)?)(?P<word>[\w.+-]+)(?=\s*(?:[])},]|$))",
    re.ASCII,
)
"""A one-word value in Hydra's grammar; or a quoted text or a call, which stay as they are."""


def keep_texts(argument: str) -> str:
    """Quote the texts in a command-line argument that Hydra would read as numbers or booleans.

    Hydra reads `revision=1.10` as the number 1.1, and `evaluation.name=true` as True. The declared
    type of the option tells which values are texts.

    Raises:
        ConfigError: An option does not exist or is written as a flag; or a group of options or the
            method has an invalid value.
    """
    dashed = re.match(r"--?([\w.]+)", argument)
    check(
        dashed is None or dashed[1] not in OPTIONS,
        f"{argument}: give each option as name=value, without dashes, such as size=5",
    )
    override = re.fullmatch(r"(\+{0,2}([\w.]+)=)(.*)", argument, re.DOTALL)
    if override is None:
        return argument
    start, name, value = override.groups()
    if name == "method":  # The method's name is one of its settings.
        one = value.strip() not in ("", "null") and not value.lstrip().startswith(("[", "{"))
        check(one, f"method={value}: give one name, such as method={DEFAULTS[name]}")
        return argument.replace("method=", "method.name=", 1)
    group = any(option.startswith(f"{name}.") for option in OPTIONS)
    check(
        not group or re.match(r"\s*[{$]", value) is not None,
        f"{name}={value}: give its own options, as {name}.NAME=...",
    )
    above = KINDS.get(name.rpartition(".")[0])
    check(above is None or get_origin(above) is dict, _no_option(name))
    parser = OverridesParser.create()

    def quoted(match: re.Match[str]) -> str:
        before, key, word = match["before"], match["key"], match["word"]
        kind = KINDS.get(f"{name}.{key}" if key else name)
        several, text = get_origin(kind) is tuple, kind in (str, str | None)
        if word is None or not (several or text):
            return match[0]
        read = parser.parse_rule(word, "primitive")
        # OmegaConf converts a number to a text, but not in a list.
        if read is None or (str(read) == word and (text or isinstance(read, str))):
            return match[0]
        return f'{before}"{word}"'

    # Inside choice(), Hydra strips the quotation marks and reads a number after all.
    return start + _WORD.sub(quoted, re.sub(r"^choice\((.+)\)$", r"\1", value))


def _no_option(name: str) -> str:
    """Return the error message for an option that does not exist, with the options that do."""
    gone = instead(name)
    if gone is not None:
        return gone
    group, _, _ = name.rpartition(".")
    known = [each for each in OPTIONS if each.startswith(f"{group}.")] or [*OPTIONS]
    close = [each for each in known if each.endswith(f".{name}")]
    close = close or difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    if not close and not group:
        hint = f"for a setting of the method give method.{name}; "
    return f"{name} is not an option: {hint}choose from {listed(known)}"


def refusal(error: Exception) -> str:
    """Return one line that explains why Hydra refused a command line."""
    if isinstance(error, MissingConfigException) and error.missing_cfg_file and error.options:
        group, _, given = error.missing_cfg_file.partition("/")
        return f"{group}={given}: choose one of {listed(error.options)}"
    text = str(error.__cause__ or error)
    unknown = re.search(r"(?:Could not override|Key) '([^'=]*)'", f"{error} {text}")
    if unknown:
        return _no_option(unknown[1])
    if isinstance(error, OverrideParseException):
        name, equals, value = error.override.partition("=")
        if not equals:
            like = f"stages={name}" if name in STAGES else "size=5"
            return f"{name}: give each option as name=value, such as {like}"
        return (
            f"{error.override}: a value with characters such as ( ) , = & needs quotation marks "
            f"for Hydra inside those of the shell: {as_typed(name, value)}"
        )
    several = re.match(r"Ambiguous value for argument '(.*?)=(.*)'$", text, re.MULTILINE)
    if several:
        name, value = several[1], re.sub(r'"([\w.+-]+)"', r"\1", several[2])  # As it was typed.
        listed_values = shlex.quote(f"{name}=[{value}]")
        return (
            f"{name}={value}: give {as_typed(name, value)} for one text, {listed_values} for a "
            "list, or -m for one run after the other"
        )
    field_name = re.search(r"full_key: (\S+)", text)
    message = " ".join(text.partition("full_key")[0].split())
    if not field_name:
        return message
    kind = KINDS.get(field_name[1])
    kinds = {kind, *get_args(kind)}
    what = "a whole number" if int in kinds else "a number" if float in kinds else "one text"
    return f"{field_name[1]}: give {what} ({message})"
