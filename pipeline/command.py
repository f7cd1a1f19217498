"""What a command line of the program asks for: one run, or a sweep of several."""

from __future__ import annotations

import os
import sys
import threading
import traceback
from importlib import import_module
from tempfile import TemporaryDirectory
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.evaluation.answers import PolicyError
from labyrinth_core.language.source_text import printable
from labyrinth_core.version import __version__
from pipeline.config.errors import ConfigError
from pipeline.config.run import (
    STAGES,
    options_of,
    refusal,
    register,
    resolve,
    with_brackets,
)
from pipeline.config.training import CONF
from pipeline.machinery.console import say
from pipeline.machinery.ending import (
    GOES_ON,
    answer_signals,
    end,
    end_interrupted,
    end_without_output,
    interrupt,
    lacks_memory,
    show_start,
)
from pipeline.machinery.executor import cluster
from pipeline.machinery.hints import hints

INTRODUCTION = """Labyrinth data for imitation learning. What can be done, in this order:

  labyrinth-datasets size=5                                      make, check, analyse, describe it
  labyrinth-datasets stages=report                               look at it, in a browser
  labyrinth-datasets size=5 'stages=[train,evaluate]' method=bc  learn from it, in minutes
  labyrinth-datasets size=5 stages=evaluate policy=my:policy     judge a policy of your own
  labyrinth-datasets stages=results                              compare what was evaluated
  labyrinth-datasets stages=publish publish.repo_id=you/labyrinth publish.version=1.0.0

--help lists the options. In Python: from labyrinth_core import load_transitions, evaluate
"""
"""What is printed where nothing is asked for."""


class RunError(RuntimeError):
    """A run of a sweep that ended with an error, which one line has explained."""


def run_command() -> int:
    """Run what the command line asks for, and return the exit status: 1 for an error."""
    if len(sys.argv) == 1:
        print(INTRODUCTION, end="")
        return 0
    if "--version" in sys.argv[1:]:  # Hydra would print its own.
        print(f"labyrinth-datasets {__version__}")
        return 0
    threading.excepthook = _end_with_thread
    sys.unraisablehook = _answer_swallowed
    # joblib's tracker would say what it clears up where the program ends at once.
    quiet = (os.environ.get("PYTHONWARNINGS"), "ignore:resource_tracker:UserWarning")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, quiet))
    sys.argv[1:] = map(with_brackets, sys.argv[1:])
    register()
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises; we print the one line that counts.
    try:
        if {"-m", "--multirun"} & {*sys.argv}:
            # Hydra writes the options of a sweep to a folder, which nobody needs.
            with TemporaryDirectory(prefix="labyrinth-sweep-") as folder:
                sys.argv.append(f"hydra.sweep.dir='{folder}'")
                perform()
        else:
            perform()
    except RunError:
        return 1
    except (HydraException, OmegaConfBaseException) as error:
        _explain(refusal(error))
        return 1
    except (ValueError, TypeError) as error:
        if HydraConfig.initialized():  # The work has begun.
            raise
        _explain(f"options that cannot be read: {one_line(error)}")  # Such as task=null.
        return 1
    return 0


@hydra.main(version_base="1.3", config_path=str(CONF.absolute()), config_name="config")
def perform(config: DictConfig) -> None:
    """Perform the stages of one run.

    Raises:
        RunError: The run is one of a sweep, which goes on with the others after an exception.
        SystemExit: The run is the only one.
    """
    reason = _error_of(config)
    if reason is None:
        return
    _explain(reason)
    if HydraConfig.get().mode == RunMode.MULTIRUN:
        raise RunError(reason)
    raise SystemExit(1)  # Of an exception, Hydra would print a line of its own.


def _error_of(config: DictConfig) -> str | None:
    """Perform the stages of one run, and return the error that ends it, None if it succeeds."""
    try:
        run = resolve(options_of(config))
        options = run.options
        stages = [import_module(STAGES[stage]) for stage in options.stages]
        for stage in stages:  # What a later one would refuse is refused before the first begins.
            getattr(stage, "refuse", lambda _: None)(run)
        answer_signals(interrupt)  # Not before: what is imported may swallow the exception.
        show_start(started=True)
        with cluster(options.executor, options.workers, options.executor_address):
            for stage in stages:
                stage.run(run)
        for line in hints(run, HydraConfig.get().overrides.task):
            say(line)
    except PolicyError as error:
        return f"{error}{_below(error)}"
    except Exception as error:
        _end_without_memory(error)
        if isinstance(error, OmegaConfBaseException):
            return refusal(error)
        if isinstance(error, ConfigError | DatasetError):
            return str(error)
        if not isinstance(error, OSError):
            raise
        if error.filename is None:
            try:
                print(flush=True)
            except OSError as lost:
                end_without_output(lost)
        return f"{error.filename or config.data_dir}: {error.strerror or error}"
    return None


def _below(error: PolicyError) -> str:
    """Return the traceback of the error of a policy itself, which is a stranger's code."""
    cause = error.__cause__
    if cause is None:
        return ""
    trace = cause.__traceback__ and cause.__traceback__.tb_next  # Without our own call.
    return "\n" + "".join(traceback.format_exception(type(cause), cause, trace)).rstrip()


def _end_without_memory(error: BaseException | None) -> None:
    """End at once if an error says that there is not enough memory."""
    if error is not None and lacks_memory(error):
        end(1, f"error: out of memory ({one_line(error):.200}); {GOES_ON}")


def _end_with_thread(ended: threading.ExceptHookArgs) -> None:
    """End for want of memory in a thread, for which another thread would wait for ever."""
    _end_without_memory(ended.exc_value)
    threading.__excepthook__(ended)


def _answer_swallowed(ignored: Any) -> None:
    """End after an interruption where Python can raise no exception, and say nothing of memory.

    Where memory has ended, the work ends by itself.
    """
    if isinstance(ignored.exc_value, KeyboardInterrupt):
        end_interrupted(*ignored.exc_value.args)
    if not isinstance(ignored.exc_value, MemoryError):
        sys.__unraisablehook__(ignored)


def _explain(reason: str) -> None:
    print(f"error: {printable(reason)}", file=sys.stderr)
