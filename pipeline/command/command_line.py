"""The command line as Hydra reads it: the schema, `--help`, texts as typed, errors in one line.

Texts stay as typed: `revision=1.10` is not the number 1.1, nor `evaluation.name=true` a boolean.
Hydra reads such values as numbers or booleans. `as_given` therefore reads the options once more,
from the overrides that Hydra kept, with quotation marks around the values of options that are
texts. A sweep hands each run a value that it has read already; `QuoteSweptTexts`, a callback of
Hydra, puts the quotation marks there before.
"""

from __future__ import annotations

import re
import shlex
from argparse import Namespace
from collections.abc import Iterable, Sequence
from copy import deepcopy
from dataclasses import field, fields, is_dataclass, make_dataclass
from functools import cache, partial
from pathlib import Path
from textwrap import TextWrapper
from typing import Any, ClassVar, cast, get_args, get_origin, get_type_hints

import hydra
from hydra._internal.utils import get_args_parser
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins
from hydra.errors import MissingConfigException, OverrideParseException
from hydra.experimental.callback import Callback
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import DictConfig, OmegaConf, read_write

from pipeline.command.composed import ALL, CONF, DEFAULTS, KINDS, OPTIONS, SECTIONS, usual_settings
from pipeline.command.stages import STAGES
from pipeline.config import ConfigError, TrainingOptions, as_typed, check, frozen

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


_WORD = re.compile(
    # A quoted value is a text already, and range(...) is a function of numbers.
    r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|\w+\([^)]*\)"""
    r"|(?P<before>(?:^|[\[({,])\s*(?:(?P<key>\w+)\s*:\s*)?)(?P<word>[\w.+-]+)(?=\s*(?:[])},]|$))",
    re.ASCII,
)
"""A one-word value in Hydra's grammar; or a quoted text or a call, which stay as they are."""


@cache
def register() -> None:
    """Register with Hydra the schema, and where configurations lie."""
    store = ConfigStore.instance()
    node = OmegaConf.structured(schema(ALL))
    node.method = {}
    OmegaConf.set_struct(node.method, False)  # A user's method has settings of its own.
    store.store(name="schema", node=node)
    Plugins.instance().register(Folders)


def help_text() -> str:
    """Return the text of `--help`."""
    width = max(map(len, OPTIONS))
    wrapper = TextWrapper(80, subsequent_indent=" " * (width + 4), break_on_hyphens=False)
    lines = []
    for heading, options in SECTIONS.items():
        lines.append(f"{heading}:")
        for name, meaning in options.items():
            default = f" [{DEFAULTS[name]}]" if DEFAULTS[name] else ""
            lines.append(wrapper.fill(f"  {name:{width}}  {meaning}{default}"))
        lines.append("")
    return _HELP.format(options="\n".join(lines))


def schema(cls: type) -> type:
    """Return a mutable class of the same options, for OmegaConf to merge values into.

    `frozen` checks lists and booleans instead, because OmegaConf refuses a single text for a list
    and reads -1 as true.
    """
    made: list[tuple[str, Any, Any]] = []
    kinds = get_type_hints(cls)
    for each in fields(cls):
        name, kind, default = each.name, kinds[each.name], each.default
        if is_dataclass(kind):
            group = schema(cast(type, kind))
            made.append((name, group, field(default_factory=group)))
        elif get_origin(kind) is tuple:
            made.append((name, Any, field(default_factory=partial(list, default))))
        elif get_origin(kind) is dict:
            made.append((name, kind, field(default_factory=cast(Any, each.default_factory))))
        else:
            made.append((name, Any if kind is bool else kind, default))
    return make_dataclass(cls.__name__, made)


class Folders(SearchPathPlugin):
    """Adds folders to those in which Hydra looks for configurations."""

    first: ClassVar[str | None] = None
    """A folder whose `config.yaml` is used instead of ours; None for ours."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        if self.first is not None:
            search_path.prepend("given", self.first, anchor="main")
        if not any(each.path.endswith(str(CONF)) for each in search_path.get_path()):
            search_path.append("labyrinth-datasets", str(CONF))  # With --config-path.


def parsed(arguments: Sequence[str]) -> Namespace:
    """Return the flags and, as `overrides`, the options of a command line, in any order.

    Raises:
        ConfigError: An option is written as a flag; or a group of options or the method has an
            invalid value.
        SystemExit: A flag does not exist, or lacks its value.
    """
    for each in arguments:
        dashed = re.match(r"--?([\w.]+)", each)
        check(
            dashed is None or dashed[1] not in OPTIONS,
            f"{each}: give each option as name=value, without dashes, such as size=5",
        )
    namespace = get_args_parser().parse_intermixed_args([*arguments])
    for each in namespace.overrides:
        _check_override(each)
    return namespace


def arranged(arguments: Sequence[str], namespace: Namespace) -> list[str]:
    """Return a command line with its options before its flags; Hydra takes none after a flag.

    `--cfg job` is left out, because Hydra would not show texts as they are typed; the caller does.

    Args:
        arguments: The command line.
        namespace: What `parsed` returned for it.
    """
    if shows_job(namespace):
        places = ("config_path", "config_name", "config_dir")
        named = {f"--{each.replace('_', '-')}": getattr(namespace, each) for each in places}
        return [
            *namespace.overrides,
            *(f"{each}={value}" for each, value in named.items() if value),
        ]
    rest, flags = [*namespace.overrides], []
    for each in arguments:
        if rest and each == rest[0]:
            del rest[0]
        else:
            flags.append(each)
    return [*namespace.overrides, *flags]


def shows_job(namespace: Namespace) -> bool:
    """Return whether a command line only asks for `--cfg job`."""
    others = ("run", "multirun", "shell_completion", "info", "help", "hydra_help")
    return namespace.cfg == "job" and not any(getattr(namespace, each) for each in others)


def shown(config: DictConfig, package: str | None, resolve: bool) -> str:
    """Return a configuration as `--cfg job` shows it.

    Args:
        config: The configuration.
        package: The group of options to show, or all.
        resolve: Whether to show the values that references stand for.

    Raises:
        ConfigError: The configuration has no such group.
    """
    if resolve:
        OmegaConf.resolve(config)
    if package in (None, "_global_"):
        return OmegaConf.to_yaml(config)
    part = OmegaConf.select(config, package)
    check(part is not None, f"--package {package}: there are no such options")
    if not OmegaConf.is_config(part):
        return f"{part}\n"
    return f"# @package {package}\n{OmegaConf.to_yaml(part)}"


def _check_override(argument: str) -> None:
    """Raise a ConfigError about a value of a group or the method that Hydra would misunderstand."""
    override = re.fullmatch(r"\+{0,2}([\w.]+)=(.*)", argument, re.DOTALL)
    if override is None:
        return
    name, value = override[1], override[2].strip()
    one = value not in ("", "null") and not value.startswith(("[", "{"))
    if name == "method":
        check(one, f"{argument}: give one name, such as method=bc")
        own = re.search(r"([\w.]+):([\w.]+)", value)
        if own is not None:
            typed = f"method=custom method._target_={own[1]}.{own[2]}"
            raise ConfigError(f"method={own[0]}: for a method of your own give {typed}")
    group = any(option.startswith(f"{name}.") for option in OPTIONS)
    check(
        not group or value.startswith(("{", "$")) or (name == "export" and one),
        f"{name}={value}: give its own options, as {name}.NAME=...",
    )
    above = KINDS.get(name.rpartition(".")[0])
    check(above is None or get_origin(above) is dict, _no_option(name))


def _no_option(name: str) -> str:
    """Return the message about an option that does not exist: its likely name, or those known."""
    group, _, _ = name.rpartition(".")
    known = [each for each in OPTIONS if group and each.startswith(f"{group}.")]
    message = str(ConfigError.no_option(name, known or OPTIONS))
    if known or "did you mean" in message or "no longer" in message:
        return message
    if any(name in usual_settings(method) for method in TrainingOptions.METHODS):
        return f"{name} is not an option: did you mean method.{name}?"
    return f"{name} is not an option: --help lists the options"


def refusal(error: Exception, folders: Iterable[str] = ()) -> str:
    """Return one line that explains why Hydra refused a command line.

    Args:
        error: The error.
        folders: The user's folders of configurations.
    """
    if isinstance(error, MissingConfigException) and error.missing_cfg_file and error.options:
        group, _, chosen = error.missing_cfg_file.partition("/")
        return f"{group}={chosen}: choose one of [{', '.join(error.options)}]"
    text = str(error.__cause__ or error)
    unknown = re.search(r"(?:Could not override|Key) '([^'=]*)'", f"{error} {text}")
    if unknown and unknown[1] in OPTIONS:
        return f"{unknown[1]}: the configuration has values of its own, so no file can be chosen"
    if unknown:
        return _no_option(unknown[1])
    if isinstance(error, OverrideParseException):
        name, equals, value = error.override.partition("=")
        if not equals:
            like = f"stages={name}" if name in STAGES else "size=5"
            return f"{name}: give each option as name=value, such as {like}"
        odd = [*dict.fromkeys(re.sub(r"[\w/.:@$%*?|\\+ -]", "", value, flags=re.ASCII))]
        what = f"for {' '.join(odd)}" if odd else "for this value"
        return (
            f"{error.override}: {what} Hydra needs quotation marks inside those of the shell: "
            f"{as_typed(name, value)}"
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
        return _fault_of_file(str(error), folders) or message
    kind = KINDS.get(field_name[1])
    kinds = {kind, *get_args(kind)}
    if get_origin(kind) is dict:
        return f"{field_name[1]}: a file chooses it in its defaults, as `- {field_name[1]}: bc`"
    if get_origin(kind) is tuple:
        what = "a list"
    else:
        what = "a whole number" if int in kinds else "a number" if float in kinds else "one text"
    return f"{field_name[1]}: give {what} ({message})"


def _fault_of_file(message: str, folders: Iterable[str]) -> str | None:
    """Return which value in a user's file Hydra cannot merge, which its message does not say.

    Args:
        message: The message, which begins with the name of the file.
        folders: Where the file may lie.
    """
    name = re.match(r"In '(.*?)': ", message)
    for path in (Path(folder, f"{name[1]}.yaml") for folder in folders if name):
        if path.is_file():
            values: Any = OmegaConf.to_container(OmegaConf.load(path))
            own = {
                key: value
                for key, value in values.items()
                if key not in ("defaults", "hydra", "method") and "${" not in str(value)
            }
            try:
                frozen(ALL, own)
            except ConfigError as error:
                return f"{error} (in {path})"
    return None


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
