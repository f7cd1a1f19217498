"""Run a command line of the program: one run, or a Hydra sweep of several."""

from __future__ import annotations

import os
import shutil
import sys
import traceback
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from tempfile import gettempdir
from typing import Any
from uuid import uuid4

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.evaluation.answers import PolicyError
from labyrinth_core.language.source_text import printable
from labyrinth_core.version import __version__
from pipeline.config.command_line import HYDRA, keep_texts, refusal, register
from pipeline.config.errors import ConfigError
from pipeline.config.run import STAGES, options_of, resolve
from pipeline.config.training import CONF
from pipeline.machinery.console import say
from pipeline.machinery.dataset import check_there
from pipeline.machinery.ending import (
    FAULTS_OF_DISKS,
    GOES_ON,
    answer_signals,
    end_interrupted,
    end_without_output,
    interrupt,
    show_start,
)
from pipeline.machinery.executor import cluster
from pipeline.machinery.hints import hints

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
    try:
        # Hydra refuses options after a flag that follows others.
        given = sorted(sys.argv[1:], key=lambda each: each not in ("-m", "--multirun"))
        sys.argv[1:] = map(keep_texts, given)
    except (HydraException, ConfigError) as error:
        _explain(refusal(error))
        return 1
    scratch = _scratch()
    register(scratch)
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises; we print the one line that counts.
    try:
        perform()
    except RunError:
        return 1
    except YAMLError as error:
        _explain(one_line(error))
        return 1
    except (HydraException, OmegaConfBaseException) as error:
        _explain(refusal(error))
        return 1
    except (ValueError, TypeError) as error:
        _explain(f"invalid options: {one_line(error)}")  # Such as task=null.
        return 1
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return 0


def _scratch() -> Path:
    """Return a temporary folder name for the files that Hydra writes in a sweep."""
    try:
        folder = gettempdir()
    except FileNotFoundError:  # Only a sweep needs one.
        folder = "."
    return Path(folder) / f"labyrinth-sweep-{uuid4().hex}"


@hydra.main(**HYDRA, config_path=str(CONF.absolute()), config_name="config")
def perform(config: DictConfig) -> None:
    """Run the stages of one run; print its error, so that Hydra raises only its own.

    Raises:
        RunError: A run of a sweep failed; after an exception, the sweep goes on with the others.
        SystemExit: A single run failed.
    """
    reason = _error_of(config)
    if reason is None:
        return
    print(printable(reason), file=sys.stderr)
    if HydraConfig.get().mode == RunMode.MULTIRUN:
        raise RunError(reason)
    raise SystemExit(1)  # For an exception, Hydra would print a line of its own.


def _error_of(config: DictConfig) -> str | None:
    """Run the stages of one run, and return the error message to print, or None on success."""
    try:
        options = options_of(config)
    except OmegaConfBaseException as error:
        return f"error: {refusal(error)}"
    except ConfigError as error:
        return f"error: {error}"
    try:
        given = HydraConfig.get().overrides.task
        named = {each.partition("=")[0] for each in given}
        run = replace(resolve(options), names_dataset=not named.isdisjoint({"size", "task"}))
        options = run.options
        check_there(run)
        stages = [import_module(STAGES[stage]) for stage in options.stages]
        for stage in stages:  # A later stage refuses before the first one begins.
            getattr(stage, "refuse", lambda _: None)(run)
        answer_signals(interrupt)  # Not before: imported modules may swallow the exception.
        show_start(started=True)
        place = options.executor_address, options.executor_wait
        with cluster(options.executor, options.workers, *place):
            for stage in stages:
                stage.run(run)
        for line in hints(run, given, _flags()):
            say(line)
    except Exception as error:
        return _explained(error)
    return None


def _flags() -> list[str]:
    """Return the command line's flags that choose the configuration, such as --config-dir=..."""
    used = HydraConfig.get()
    flags = {"--config-name": used.job.config_name} if used.job.config_name != "config" else {}
    for source in used.runtime.config_sources:
        if source.provider == "command-line":
            flags["--config-dir"] = source.path
        elif source.provider == "main" and Path(source.path) != CONF:
            flags["--config-path"] = source.path
    return [f"{flag}={value}" for flag, value in flags.items()]


def _explained(error: Exception) -> str:
    """Return the line that explains an error to its user, or the traceback of a bug."""
    if isinstance(error, PolicyError):
        return f"error: {error}{_below(error)}"
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


def _below(error: PolicyError) -> str:
    """Return the traceback of the error inside a policy, which is the user's own code."""
    cause = error.__cause__
    if cause is None:
        return ""
    trace = cause.__traceback__ and cause.__traceback__.tb_next  # Without our own frame.
    return "\n" + "".join(traceback.format_exception(type(cause), cause, trace)).rstrip()


def _answer_swallowed(ignored: Any) -> None:
    """End the program after an interruption that Python cannot raise as an exception."""
    if isinstance(ignored.exc_value, KeyboardInterrupt):
        end_interrupted(*ignored.exc_value.args)
    sys.__unraisablehook__(ignored)


def _explain(reason: str) -> None:
    print(f"error: {printable(reason)}", file=sys.stderr)
