"""Run a command line of the program, one run or a Hydra sweep, and suggest the next one."""

from __future__ import annotations

import os
import shlex
import sys
import traceback
from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import hydra
from hydra._internal.hydra import Hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from labyrinth_core.errors import DatasetError, one_line, printable
from labyrinth_core.evaluation import PolicyError
from labyrinth_core.version import __version__
from pipeline.command.command_line import (
    HYDRA,
    Folders,
    arranged,
    as_given,
    help_text,
    overrides_of,
    parsed,
    refusal,
    register,
    shown,
    shows_job,
)
from pipeline.command.composed import (
    CONF,
    GROUPS,
    KINDS,
    SHARED,
    as_file,
    names_in,
    options_of,
    resolve,
    unused,
)
from pipeline.command.ending import (
    FAULTS_OF_DISKS,
    GOES_ON,
    answer_signals,
    end_interrupted,
    end_without_output,
    interrupt,
    show_start,
)
from pipeline.command.stages import STAGES
from pipeline.config import ConfigError, Job, as_typed
from pipeline.machinery import cluster, say

INTRODUCTION = """Maze datasets for imitation learning. The usual commands, in order:

  labyrinth-datasets size=5                                      make, check and describe a dataset
  labyrinth-datasets stages=report                               look at it in a browser
  labyrinth-datasets size=5 'stages=[train,evaluate]' method=bc  train a policy on it, in minutes
  labyrinth-datasets size=5 stages=evaluate policy=my:policy     evaluate a policy of your own
  labyrinth-datasets stages=results                              compare all evaluated policies
  labyrinth-datasets stages=publish publish.repo_id=you/labyrinth publish.version=1.0.0

--help lists the options. In Python: from labyrinth_core import load_transitions, evaluate
"""
"""Printed when the command line is empty."""


class RunError(RuntimeError):
    """A run of a sweep failed; its error has been printed already."""


def run_command() -> int:
    """Run the command line and return the exit status, 1 after an error."""
    if len(sys.argv) == 1:
        print(INTRODUCTION, end="")
        return 0
    if "--version" in sys.argv[1:]:  # Hydra would print its own version.
        print(f"labyrinth-datasets {__version__}")
        return 0
    sys.unraisablehook = _answer_swallowed
    # After an abrupt exit, joblib's resource tracker would warn about what it cleans up.
    quiet = (os.environ.get("PYTHONWARNINGS"), "ignore:resource_tracker:UserWarning")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, quiet))
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises; we print the one line that counts.
    folders: list[str] = []
    try:
        namespace = parsed(sys.argv[1:])
        # Hydra would read every file of every group first.
        if namespace.help and not namespace.hydra_help:
            print(help_text())
            return 0
        folders += filter(None, (namespace.config_dir, namespace.config_path))
        register()
        sys.argv[1:] = arranged(sys.argv[1:], namespace)
        own = namespace.config_dir and namespace.config_name
        Folders.first = str(Path(namespace.config_dir).absolute()) if own else None
        task = (lambda config: _show(namespace, config)) if shows_job(namespace) else perform
        with _composed_once(namespace):
            hydra.main(**HYDRA, config_path=str(CONF), config_name="config")(task)()
    except RunError:
        return 1
    except YAMLError as error:
        _explain(one_line(error))
    except (HydraException, OmegaConfBaseException, ConfigError) as error:
        _explain(refusal(error, folders))
    except OSError as error:
        if error.filename is None and not _is_of_hydra(error):
            raise
        path = f"{error.filename}: " if error.filename else "invalid options: "
        _explain(f"{path}{error.strerror or one_line(error)}")  # The folder of a sweep, or a file.
    except ValueError as error:
        # Of a command line that Hydra cannot use; else it is a bug.
        if not _is_of_hydra(error):
            raise
        _explain(f"invalid options: {one_line(error)}")
    else:
        return 0
    return 1


def _is_of_hydra(error: Exception) -> bool:
    """Return whether Hydra or OmegaConf raised an error."""
    *_, (last, _) = traceback.walk_tb(error.__traceback__)
    return last.f_globals["__name__"].partition(".")[0] in ("hydra", "omegaconf")


def _show(namespace: Namespace, config: DictConfig) -> None:
    """Print a configuration, for `--cfg job`."""
    config = as_given(config, overrides_of(HydraConfig.get()))
    print(shown(config, namespace.package, namespace.resolve), end="")


@contextmanager
def _composed_once(namespace: Namespace) -> Iterator[None]:
    """Tell Hydra within the context that a command line asks for one run, if that is certain.

    Hydra would compose the whole configuration to read `hydra.mode` in it, and then compose it
    again for the run, which takes 3% of `python run.py size=5`. Only a flag, an override of other
    options than ours, or a file of the user can ask for a sweep.
    """
    flags = (namespace.multirun, namespace.config_dir, namespace.config_path, namespace.config_name)
    typed = {name.partition(".")[0] for name in names_in(namespace.overrides)}
    asked = Hydra.get_mode
    if typed <= GROUPS and not any(flags):
        Hydra.get_mode = lambda *_, **__: RunMode.RUN  # type: ignore[method-assign]
    try:
        yield
    finally:
        Hydra.get_mode = asked  # type: ignore[method-assign]


def perform(config: DictConfig) -> float | None:
    """Run the stages of one run, and return what a sweep may maximise.

    That is the success rate on validation of a run that trains; None for other runs.

    Raises:
        RunError: A run of a sweep failed; after an exception, the sweep goes on with the others.
        SystemExit: A single run failed. It printed its error, and Hydra shall print none.
    """
    try:
        overrides = overrides_of(HydraConfig.get())
        options, jobs = _jobs(config, overrides)
        modules = {stage: import_module(STAGES[stage].module) for stage in jobs}
        for stage, job in jobs.items():  # A later stage refuses before the first one begins.
            getattr(modules[stage], "refuse", lambda _: None)(job)
        answer_signals(interrupt)  # Not before: imported modules may swallow the exception.
        show_start(started=True)
        objective: float | None = None
        with cluster(options.executor, options.workers):
            for stage, job in jobs.items():
                result = modules[stage].run(job)
                objective = objective if result is None else result
        *_, (stage, job) = jobs.items()
        match STAGES[stage].next_step(job, [*jobs]):
            case (line,):
                say(line)
            case (added, purpose):
                if line := next_command(options, added, purpose, overrides, _flags()):
                    say(line)
    except Exception as error:
        reason = _explained(error)
    else:
        return objective
    print(printable(reason), file=sys.stderr)
    if HydraConfig.get().mode == RunMode.MULTIRUN:
        raise RunError(reason)
    raise SystemExit(1)


def _jobs(config: DictConfig, overrides: Sequence[str]) -> tuple[Any, Mapping[str, Job[Any]]]:
    """Return all options of a run, and the job of each of its stages.

    Options that no requested stage uses are named on the terminal.
    """
    typed = names_in(overrides)
    try:
        config = as_given(config, overrides)
        options = options_of(config, overrides)
    except OmegaConfBaseException as error:
        raise ConfigError(refusal(error)) from error
    if lost := unused(typed, options):
        users = (f"{name} (for {', '.join(stages)})" for name, stages in lost.items())
        say(f"No requested stage uses {'; '.join(users)}.", once=True)
    named = not {"size", "task"}.isdisjoint(typed)
    return options, resolve(options, names_dataset=named, composed=partial(as_file, config))


def _flags() -> list[str]:
    """Return the command line's flags that choose the configuration, such as --config-dir=..."""
    used = HydraConfig.get()
    name = used.job.config_name
    flags = {"--config-name": name} if name != "config" or Folders.first is not None else {}
    for source in used.runtime.config_sources:
        if source.provider == "command-line":
            flags["--config-dir"] = source.path
        elif source.provider == "main" and Path(source.path) != CONF:
            flags["--config-path"] = source.path
    return [f"{flag}={value}" for flag, value in flags.items()]


def _explained(error: Exception) -> str:
    """Return the line that explains an error to its user, or the traceback of a bug."""
    if isinstance(error, PolicyError):
        cause, below = error.__cause__, ""
        if cause is not None:  # The error inside the policy, which is the user's own code.
            trace = cause.__traceback__ and cause.__traceback__.tb_next  # Without our own frame.
            below = "\n" + "".join(traceback.format_exception(type(cause), cause, trace)).rstrip()
        return f"error: {error}{below}"
    if isinstance(error, ConfigError | DatasetError):
        return f"error: {error}"
    if isinstance(error, OSError) and error.filename is not None:
        return f"error: {error.filename}: {error.strerror or error}"
    if isinstance(error, FileNotFoundError):  # From tempfile; its message names the folders.
        return f"error: {error.strerror or error}"
    if isinstance(error, OSError):
        try:
            print(flush=True)
        except OSError as lost:
            end_without_output(lost)
        if error.errno in FAULTS_OF_DISKS:  # The error of an open file does not name the file.
            return f"error: {error.strerror}: once that is fixed, {GOES_ON}"
    return "".join(traceback.format_exception(error)).rstrip()


def _answer_swallowed(ignored: Any) -> None:
    """End the program after an interruption that Python cannot raise as an exception."""
    if isinstance(ignored.exc_value, KeyboardInterrupt):
        end_interrupted(*ignored.exc_value.args)
    sys.__unraisablehook__(ignored)


def _explain(reason: str) -> None:
    print(f"error: {printable(reason)}", file=sys.stderr)


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
