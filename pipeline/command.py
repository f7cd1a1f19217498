"""What a command line of the program asks for: one run, or a sweep of several."""

from __future__ import annotations

import os
import sys
from importlib import import_module

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.language.source_text import printable
from labyrinth_core.version import __version__
from pipeline.config.errors import ConfigError
from pipeline.config.run import STAGES, options_of, refusal, register, resolve, with_brackets
from pipeline.config.training import CONF
from pipeline.machinery.executor import cluster


class RunError(RuntimeError):
    """A run that ended with a mistake, which one line has explained."""


def run_command() -> int:
    """Run what the command line asks for, and return the exit status: 1 for a mistake."""
    if "--version" in sys.argv[1:]:  # Hydra would print its own.
        print(f"labyrinth-datasets {__version__}")
        return 0
    sys.argv[1:] = map(with_brackets, sys.argv[1:])
    register()
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises; we print the one line that counts.
    try:
        perform()
    except RunError:
        return 1
    except (HydraException, OmegaConfBaseException) as error:
        _explain(refusal(error))
        return 1
    except ValueError as error:
        if "Config group override" not in str(error):  # What Hydra says of `task=null`.
            raise
        _explain(str(error))
        return 1
    return 0


@hydra.main(version_base="1.3", config_path=str(CONF.absolute()), config_name="config")
def perform(config: DictConfig) -> None:
    """Perform the stages of one run.

    Raises:
        RunError: The run is one of a sweep, which goes on with the others after an exception.
        SystemExit: The run is the only one.
    """
    reason = _mistake(config)
    if reason is None:
        return
    _explain(reason)
    if HydraConfig.get().mode == RunMode.MULTIRUN:
        raise RunError(reason)
    raise SystemExit(1)  # Of an exception, Hydra would print a line of its own.


def _mistake(config: DictConfig) -> str | None:
    """Perform the stages of one run, and return what is wrong with it, None if nothing is."""
    try:
        options = options_of(config)
        run = resolve(options)
        with cluster(options.executor, options.workers, options.executor_address):
            for stage in options.stages:
                import_module(STAGES[stage]).run(run)
    except OmegaConfBaseException as error:
        return refusal(error)
    except (ConfigError, DatasetError) as error:
        return str(error)
    except OSError as error:
        return f"{error.filename or options.data_dir}: {error.strerror or error}"
    return None


def _explain(reason: str) -> None:
    print(f"error: {printable(reason)}", file=sys.stderr)
